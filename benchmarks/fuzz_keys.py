"""Say anything on every key that a launch hears, and see that it goes on, or ends with one line.

    python benchmarks/fuzz_keys.py                        # 10⁶ messages, some minutes
    python benchmarks/fuzz_keys.py --messages 5000 --seed 7
    python benchmarks/fuzz_keys.py forge --runs 20        # in the nodes' names: the run ends with one error

harmless   bytes that are no messages, mutations of real ones, control messages and questions of a grammar that
           claim what cannot be, on the keys of edges, control, keeper, look, steps, echo, epochs, roster and notes
forge      well-formed messages of nodes, changed in their content and put on the nodes' own keys

The launch is that of the tests: a world and two nodes. Of `harmless`, exit code 1 where a process ends, epochs come
to a stop, the digest is not that of `hierax run`, or a process has taken more than 100 MB over the undisturbed launch;
of `forge` where a launch neither ends with one error that names the sender nor has the right digest.
"""

from __future__ import annotations

import argparse
import json
import random
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.hostile import Stranger  # noqa: E402
from support.live import HIERAX, Live, environment, until  # noqa: E402

from hierax.schemas.control import Control  # noqa: E402
from hierax.schemas.errors import SchemaError  # noqa: E402
from hierax.schemas.keys import Keys  # noqa: E402
from hierax.schemas.messages import EDGE_KINDS, KINDS, Header, Message, decode_message, encode_message  # noqa: E402
from hierax.schemas.values import encode_value  # noqa: E402

ALLOWED_BYTES = 100 << 20
ASKED_EVERY = 500
NAMES = ("world", "low", "high", "stranger", "", "*", "a/b", "x" * 200)
NUMBERS = (0, 1, 2, -1, 7, 255, 10**9, 10**12, 2**53, 2**63 - 1, 2**64 - 1)
KINDS_OF_CONTROL = {kind.__name__: len(kind._fields) for kind in get_args(Control)}
"""By name, how many fields they have."""


class Grammar:
    """Makes bytes by the grammar of what is said in a launch, and by changing what was said.

    Args:
        rng: of all that it makes.
        stranger: has heard what is said.
        tokens: of the processes, by node.
    """

    def __init__(self, rng: random.Random, stranger: Stranger, tokens: dict[str, str]) -> None:
        self._rng = rng
        self._stranger = stranger
        self._tokens = tokens
        self._seeds: list[tuple[str, bytes]] = []

    def refresh(self) -> None:
        """Take over what was heard of late."""
        self._seeds = [each for each in list(self._stranger.heard) if len(each[1]) < 4096]

    def value(self, depth: int = 0) -> Any:
        """Any value."""
        rng = self._rng
        kind = rng.randrange(12 if depth < 4 else 8)
        if kind < 2:
            return rng.choice(NUMBERS)
        if kind < 4:
            return rng.choice((*NAMES, *self._tokens.values()))
        if kind == 4:
            return rng.choice((None, True, False, float("nan"), 1e300, -0.0))
        if kind == 5:
            return rng.randbytes(rng.randrange(64))
        if kind == 6:
            return np.zeros(rng.randrange(4), rng.choice((np.uint8, np.float64, bool)))
        if kind == 7:
            return "é" * rng.randrange(50)
        if kind < 10:
            return tuple(self.value(depth + 1) for _ in range(rng.randrange(4)))
        return {rng.choice(("look", "ask", "edges", "every", "change", "nodes", "name")): self.value(depth + 1)}

    def message(self) -> tuple[str, bytes]:
        """A message along an edge that claims what cannot be: of a stranger, far ahead, or long past."""
        rng = self._rng
        sender, receiver = rng.choice((("world", "low"), ("low", "high"), ("high", "low"), ("low", "world")))
        kind = rng.choice(EDGE_KINDS)
        wrong = rng.randrange(4)
        header = Header(
            kind,
            sender if wrong else "stranger",
            receiver,
            rng.choice(NUMBERS[6:]) if wrong == 1 else rng.randrange(1000),
            rng.choice(NUMBERS[6:]) if wrong == 2 else 0,
            0,
            rng.choice(NUMBERS[4:]) if wrong == 3 else 0,
            0.0,
            rng.randbytes(32),
        )
        return self._stranger.keys.edge(kind, sender, receiver), encode_message(Message(header, (self.value(),)))

    def word(self) -> tuple[str, bytes]:
        """A control message; of those with numbers that may fit, none fits."""
        rng = self._rng
        kind = rng.choice(list(KINDS_OF_CONTROL))
        count = KINDS_OF_CONTROL[kind]
        fields = [self.value() for _ in range(count)]
        if rng.random() < 0.7:
            fields = [self._fitting(kind, index) for index in range(count)]
        keys = self._stranger.keys
        key = rng.choice((*map(keys.words, self._tokens), *map(keys.control, self._tokens.values())))
        return key, encode_value((kind, *fields))

    def _fitting(self, kind: str, index: int) -> Any:
        rng = self._rng
        far = rng.choice((10**9, 10**12, 2**53 - 1))
        name = rng.choice(("world", "low", "high"))
        roster = {"world": "world", "nodes": {}, "edges": (), "version": far, "instances": {}}
        fields: dict[str, tuple[Any, ...]] = {
            "Prepare": (roster, (name,), (name,)),
            "Unchanged": (far, rng.choice((0, far))),
            "HandOver": (far, far, 0),
            "TakeOver": (far, far, 0, b"state", b"under way"),
            "AskStatus": (rng.choice(NUMBERS[:8]),),
            "Resend": (rng.randrange(2000), 0, (name,)),
            "CatchUp": (far,),
            "Dismiss": ("somebody says so", rng.random() < 0.5),
            "Join": (name, rng.choice((*self._tokens.values(), "forged")), "", far, rng.random() < 0.8, "", far, 0),
            "Ready": (name, self._tokens[name], far, ""),
            "State": (name, far, b"state", b"under way"),
            "Taken": (name, far, ""),
            "Fetch": (name, self._tokens[name], rng.choice((0, far))),
            "Status": (name, rng.choice(NUMBERS[:8]), far, 0, (), "", 0),
            "CaughtUp": (name, self._tokens[name], far),
            "Failed": (name, self._tokens[name], far, name, "somebody says so"),
            "Lost": (name, rng.choice((self._tokens[name], "")), rng.random() < 0.5),
            "Census": ({name: "forged"},),
            "Propose": ("forged", {"change": "detach", "name": name, "cascade": True}, {}, {}, ()),
        }  # fmt: skip
        return fields[kind][index]

    def mutated(self) -> tuple[str, bytes]:
        """Something that was said, changed so that it says it no more: on its own key or on another."""
        rng = self._rng
        if not self._seeds:
            return self.garbage()
        key, data = rng.choice(self._seeds)
        kind = rng.randrange(5)
        if kind == 0:
            data = data[: rng.randrange(len(data) + 1)]
        elif kind == 1:
            data += rng.randbytes(rng.randrange(1, 9))
        elif kind == 2:
            at = rng.randrange(len(data) + 1)
            data = data[:at] + rng.randbytes(rng.randrange(1, 17)) + data[at:]
        elif kind == 3:
            data = data[:1] + bytes(rng.choices(range(256), k=len(data)))
        else:
            key = rng.choice(self._seeds)[0]
        return key, data

    def garbage(self) -> tuple[str, bytes]:
        """Any bytes on any key, also lengths that lie."""
        rng = self._rng
        keys = self._stranger.keys
        node = rng.choice(("world", "low", "high"))
        key = rng.choice((
            keys.edge(rng.choice((*KINDS, "interrupt", "x")), rng.choice(("world", "low", "high", "s")), node),
            keys.control(rng.choice([*self._tokens.values()])), keys.words(node), keys.look(node), keys.steps(node),
            keys.launch, keys.changes, keys.seen("obs", "low", "high"), keys.epochs, keys.roster, keys.notes,
        ))  # fmt: skip
        head = rng.choice((b"", b"\x9c", b"\xdc\x00\x0e", b"\xdd\xff\xff\xff\xff", b"\xdb\x7f\xff\xff\xff", b"\xc9"))
        return key, head + rng.randbytes(rng.choice((0, 1, 8, 100, 5000)))

    def question(self) -> tuple[str, bytes]:
        """A question to a node or the keeper."""
        rng = self._rng
        keys = self._stranger.keys
        key = rng.choice((keys.look("world"), keys.look("low"), keys.look("high"), keys.launch, keys.changes))
        look = rng.choice(("meter", "state", "neighbours", "echo", "steps", self.value()))
        ask = rng.choice(("ps", "change", "record", self.value()))
        fields = {"look": look, "ask": ask, "every": self.value(), "edges": self.value(), "pid": -1}
        return key, rng.choice((encode_value(self.value()), encode_value(fields), rng.randbytes(20)))


def says_it_again(key: str, data: bytes) -> bool:
    """Whether bytes on an edge's key are a message that a node might take for its neighbour's."""
    try:
        header = decode_message(data).header
    except SchemaError:
        return False
    return key.endswith(f"/{header.kind}/{header.sender}/{header.receiver}") and header.epoch < 10**6


def rss_bytes(pid: int) -> int:
    """The memory that a process has in hand, without files that it has mapped."""
    pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return (int(pages[1]) - int(pages[2])) * 4096


def memory(live: Live) -> dict[str, int]:
    """By node, and for the supervisor."""
    found = {name: rss_bytes(int(node["pid"])) for name, node in live.run["nodes"].items()}
    return {**found, "supervisor": rss_bytes(live.launch.process.pid)}


def repeated(live: Live, epochs: int) -> str:
    """The digest of as many epochs in one process, however long that takes."""
    command = [*HIERAX, "run", str(live.file), "--epochs", str(epochs), "--format", "json"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(live.folder), check=True)
    return str(json.loads(done.stdout)["digest"])


def harmless(seed: int, messages: int) -> bool:
    """Say much that is of no use; whether the launch did not mind."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        live = Live(Path(folder))
        try:
            return _harmless(live, rng, messages)
        except AssertionError:
            print("".join(live.launch.err[-40:]))
            raise
        finally:
            live.close()


def _harmless(live: Live, rng: random.Random, messages: int) -> bool:
    before = live.run
    tokens = {name: str(node["process"]) for name, node in before["nodes"].items()}
    undisturbed = memory(live)
    counts: Counter[str] = Counter()
    begun = time.monotonic()
    with Stranger(live.endpoint, Keys("live", str(before["run"])), kept=512, secret=live.secret) as stranger:
        until(lambda: len(stranger.heard) > 50, "what is said")
        grammar = Grammar(rng, stranger, tokens)
        makers = (grammar.message, grammar.word, grammar.mutated, grammar.garbage)
        for number in range(messages):
            if number % ASKED_EVERY == 0:
                grammar.refresh()
                key, question = grammar.question()
                stranger.ask(key, question, 2.0)
                counts["questions"] += 1
            maker = rng.choice(makers)
            key, data = maker()
            if maker != grammar.message and says_it_again(key, data):
                continue  # that would be one in a node's name
            stranger.put(key, data)
            counts[maker.__name__] += 1
    took_s = time.monotonic() - begun
    live.goes_on()
    now = live.run
    most = {name: size - undisturbed[name] for name, size in memory(live).items()}
    same = {name: str(node["process"]) for name, node in now["nodes"].items()} == tokens
    report = live.ends()
    right = report["digest"] == repeated(live, report["epochs"])
    small = max(most.values()) <= ALLOWED_BYTES
    lines = sum("hierax: " in line for line in live.launch.err)
    grown = ", ".join(f"{name} {size / 1e6:.1f} MB" for name, size in most.items())
    print(f"{sum(counts.values())} messages ({dict(counts)}) in {took_s:.0f} s, {report['epochs']} epochs")
    print(
        f"processes {'the same' if same else 'others'}, digest {'equal' if right else 'NOT EQUAL'}, grown by: {grown}"
    )
    print(f"{lines} lines on the console")
    return same and right and small


def forge(seed: int) -> bool:
    """Speak in the nodes' names; whether the launch ended with one error that names one, or with the right digest."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        live = Live(Path(folder))
        try:
            with Stranger(live.endpoint, Keys("live", str(live.run["run"])), secret=live.secret) as stranger:
                patience = time.monotonic() + 5.0
                with suppress(AssertionError):  # nothing is said any more: it has ended, or does not go on
                    while live.launch.process.poll() is None and time.monotonic() < patience:
                        _forge_one(rng, stranger)
            if live.launch.process.poll() is None:
                report = live.ends()
                right = bool(report["digest"] == repeated(live, report["epochs"]))
                print(f"seed {seed}: went on, digest {'equal' if right else 'NOT EQUAL'}")
                return right
            live.launch.ends()
            errors = [line for line in live.launch.err if line.startswith("error: ")]
            print(f"seed {seed}: exit code {live.launch.process.returncode}, {''.join(errors).strip()}")
            named = len(errors) == 1 and "in the name of" in errors[0]
            return live.launch.process.returncode == 1 and named and "Traceback" not in "".join(live.launch.err)
        finally:
            live.close()


def _forge_one(rng: random.Random, stranger: Stranger) -> None:
    kind, sender, receiver = rng.choice(
        (("obs", "world", "low"), ("obs", "low", "high"), ("ctx", "high", "low"), ("ctx", "low", "world"))
    )
    seen = stranger.next(kind, sender, receiver)
    header = seen.header._replace(epoch=seen.header.epoch + rng.randrange(4), attempt=rng.choice((0, 0, 0, 3)))
    payload = rng.choice((seen.payload, (*seen.payload, rng.randrange(9)), ()))
    stranger.send(Message(header, payload))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("harmless", "forge"), default="harmless")
    parser.add_argument("--messages", type=int, default=1_000_000)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=struct.unpack("I", random.randbytes(4))[0])
    given = parser.parse_args(arguments)
    print(f"seed {given.seed}", flush=True)
    if given.what == "harmless":
        return 0 if harmless(given.seed, given.messages) else 1
    return 0 if all(list(map(forge, range(given.seed, given.seed + given.runs)))) else 1


if __name__ == "__main__":
    sys.exit(main())
