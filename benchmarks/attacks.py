"""Attack hierax in every way that is known, and see that nothing comes of it.

    python benchmarks/attacks.py                          # floods of 10⁵ messages and 100 MB, some minutes
    python benchmarks/attacks.py --messages 2000 --megabytes 8
    python benchmarks/attacks.py files                    # closed, encrypted, roles or files alone

closed      a launch on one machine: the attacker has no key, a wrong one, another run's, or an old run's
encrypted   a launch with --host: it has no certificate, another run's, or one of the two secrets of the right run
roles       a launch with --host: it has a key or certificate of the run, for another role; floods too
files       recordings, folders, checkpoints, rosters, keys, deployment files and answers of what is no launch

Launches are attacked by another user where root starts this, as client and as peer, at the port of every process, and
last without Zenoh. One row is printed for each attack. Exit code 1 where anything comes of one: the digest is not that
of `hierax run`, nobody was told of who was refused, code was run, a file is answered otherwise than by one line, or a
process has taken more than 50 MB over what it takes undisturbed.
"""

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support import file_attacks  # noqa: E402
from support.attacks import attacked, linked, order_for  # noqa: E402
from support.live import Live  # noqa: E402
from support.role_attacks import RoleAttack  # noqa: E402

from hierax.runtime.host.run_folder import run_folder  # noqa: E402
from hierax.runtime.host.run_secret import certificates_of, new_secret, token_of  # noqa: E402
from hierax.schemas.access import LATER, OPERATOR, READER  # noqa: E402

ALLOWED_BYTES = 50 << 20
TRIED = ("put", "delete", "offer answers", "claim to live")  # by who has any certificate
LEAST = 40  # attacks
CALLED = {READER: "a reader", OPERATOR: "an operator", LATER: "a later node", "high": "node high"}
_OFTEN = re.compile(r"(.*)refused .*no (key|certificate) of this run(?: \((\d+) times by now\))?")


class Row(NamedTuple):
    """An attack, and what came of it; empty: nothing."""

    what: str
    came: str
    told: str = ""  # to whom it is done


Options = argparse.Namespace
Secrets = dict[str, str | None]


def main() -> int:
    """Attack, and tell of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=[*WAYS, []])
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--megabytes", type=int, default=100)
    options = parser.parse_args()
    rows: list[Row] = []
    for way in options.what or WAYS:
        with tempfile.TemporaryDirectory(prefix="hierax-attacks-") as folder:
            for row in WAYS[way](Path(folder), options):
                print(f"{'FAILED' if row.came else 'refused'}  {way}: {row.what}: {row.came or row.told}", flush=True)
                rows.append(row)
    failed = sum(1 for row in rows if row.came)
    print(f"{len(rows)} attacks, something came of {failed}")
    return int(failed > 0 or (not options.what and len(rows) < LEAST))


def closed(folder: Path, options: Options) -> Iterator[Row]:
    """A launch on one machine."""

    def secrets(live: Live, other: str, old: str) -> Secrets:
        return {"no key": None, "a wrong key": new_secret(), "another run's key": other, "an old run's key": old}

    return _launched(folder, options, secrets)


def encrypted(folder: Path, options: Options) -> Iterator[Row]:
    """A launch that other machines may join."""

    def secrets(live: Live, other: str, old: str) -> Secrets:
        token, authority = token_of(live.secret), certificates_of(live.secret)
        return {
            "no certificate": None,
            "the password alone": token,
            "another run's certificate and password": other,
            "an old run's certificate and password": old,
            "another run's certificate": f"{token}\n{certificates_of(other)}",
            "another run's password": f"{token_of(other)}\n{authority}",
        }

    return _launched(folder, options, secrets, "--host", "127.0.0.1")


def files(folder: Path, options: Options) -> Iterator[Row]:
    """Files and answers."""
    for name, outcome in file_attacks.attacked(folder).items():
        yield Row(name, outcome["came"], outcome["line"] or "harmless")


def roles(folder: Path, options: Options) -> Iterator[Row]:
    """A launch that other machines may join, by who has a key or certificate of it."""
    with ExitStack() as stack:
        live = Live(folder, "--host", "127.0.0.1")
        stack.callback(live.close)
        attack = RoleAttack(live)
        stack.callback(attack.close)
        audit = run_folder(live.run["run"]) / "logs" / "_audit.jsonl"
        pids = [live.launch.process.pid, *(node["pid"] for node in live.run["nodes"].values())]
        before = {pid: most_bytes(pid) for pid in pids}
        for outcome in (attack.all(), attack.floods(options.messages, options.megabytes << 20)):
            yield from _rows(outcome)
        live.goes_on()
        yield _memory(before)
        live.is_repeated_by()
        yield Row("digest", "", "that of `hierax run`")
        for who in attack.roles:
            said = f"refused the certificate of {CALLED[who]}: it may not "
            tried = {line.partition(said)[2].partition(" on ")[0] for line in messages(audit) if said in line}
            asks = {"ask"} if who != OPERATOR else set()
            listens = {"listen"} if who in (LATER, "high") else set()
            lacks = ({*TRIED} | asks | listens) - tried
            yield Row(f"{who} is told of", f"not that {', '.join(lacks)}" if lacks else "", ", ".join(sorted(tried)))


WAYS: dict[str, Callable[[Path, Options], Iterator[Row]]] = {
    "closed": closed,
    "encrypted": encrypted,
    "roles": roles,
    "files": files,
}


def _launched(
    folder: Path, options: Options, secrets: Callable[[Live, str, str], Secrets], *launched: str
) -> Iterator[Row]:
    with ExitStack() as stack:

        def launch(name: str) -> Live:
            (folder / name).mkdir()
            live = Live(folder / name, *launched)
            stack.callback(live.close)
            return live

        over = launch("old")
        old = over.secret
        over.close()
        other, live = launch("other"), launch("attacked")
        order = order_for(live, secrets(live, other.secret, old), options.messages, options.megabytes << 20)
        audit = run_folder(live.run["run"]) / "logs" / "_audit.jsonl"
        live.goes_on()
        for who, count in linked(live, order, folder).items():
            yield Row(f"{who} links, so who does not is refused", "" if count else "it did not", f"{count} links")
        before = {pid: most_bytes(pid) for pid in order["pids"]}
        outcome = attacked(order, folder)
        yield from _rows(outcome)
        live.goes_on()
        yield _memory(before)
        live.is_repeated_by()
        yield Row("digest", "", "that of `hierax run`")
        lacks, by = refusals(audit)
        told = ", ".join(f"no {lack}: {count} times and more" for lack, count in sorted(lacks.items()))
        least = len(outcome) - 1  # of these one has sent bytes that are none of Zenoh's
        few = "" if sum(lacks.values()) >= least else f"{told or 'nobody is told'}, of {least} at least"
        yield Row("who was refused is in the audit", few, told)
        silent = {*order["tokens"]} - by
        lacking = f"not {', '.join(sorted(silent))}" if silent else ""
        yield Row("each process tells of it", lacking, ", ".join(sorted(by)))


def _rows(outcome: dict[str, dict[str, int]]) -> Iterator[Row]:
    for who, each in outcome.items():
        for what, count in each.items():
            yield Row(f"{who}: {what}", f"{count} times" if count else "", "0")


def messages(audit: Path) -> list[str]:
    """What a launch's audit says."""
    return [json.loads(line)["message"] for line in audit.read_text(encoding="utf-8").splitlines()]


def _memory(before: dict[int, int]) -> Row:
    """Whether all processes have taken as little as that over what they had taken before."""
    grown = max(most_bytes(pid) - bytes_before for pid, bytes_before in before.items())
    allowed = grown <= ALLOWED_BYTES
    return Row("memory", "" if allowed else f"{grown >> 20} MB more", f"at most {grown / 2**20:.1f} MB more")


def refusals(audit: Path) -> tuple[dict[str, int], set[str]]:
    """How often somebody was refused for lack of what, at least, and by processes of which nodes, by an audit."""
    often: dict[tuple[str, str], int] = {}
    for line in messages(audit):
        found = _OFTEN.match(line)
        if found:
            often[found[1], found[2]] = max(often.get((found[1], found[2]), 0), int(found[3] or 1))
    lacks: dict[str, int] = {}
    for (_, lack), count in often.items():
        lacks[lack] = lacks.get(lack, 0) + count
    return lacks, {by.rstrip(": ") for by, _ in often if by}


def most_bytes(pid: int) -> int:
    """How many bytes a process had at most."""
    return int(re.findall(r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text())[0]) << 10


if __name__ == "__main__":
    sys.exit(main())
