"""Attack a launch without its key, in every way that Zenoh offers, and see that nothing comes of it.

    python benchmarks/attacks.py                          # floods of 10⁵ messages and 100 MB, some minutes
    python benchmarks/attacks.py --messages 2000 --megabytes 8

The attacker is another user where root starts this. It has no key, a wrong one, another run's, or an old run's; it
links as a client and as a peer, to the port of every process; and last comes without Zenoh. Exit code 1 where anything
comes of an attack, the digest is not that of `hierax run`, or a process has taken more than 50 MB over what it had.
"""

import argparse
import re
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.attacks import attacked, order_for  # noqa: E402
from support.live import Live  # noqa: E402

from hierax.runtime.host.run_secret import new_secret  # noqa: E402

ALLOWED_BYTES = 50 << 20


def main() -> int:
    """Attack, and tell of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--megabytes", type=int, default=100)
    options = parser.parse_args()
    with ExitStack() as stack:
        folders = [Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(3)]
        over = Live(folders[0])
        old = over.secret
        over.close()
        other, live = (Live(folder) for folder in folders[1:])
        stack.callback(live.close)
        stack.callback(other.close)
        secrets = {"no key": None, "wrong key": new_secret(), "another run's key": other.secret, "old run's key": old}
        order = order_for(live, secrets, options.messages, options.megabytes << 20)
        live.goes_on()
        before = {pid: most_bytes(pid) for pid in order["pids"]}
        outcome = attacked(order, folders[2])
        live.goes_on()
        grown = max(most_bytes(pid) - before[pid] for pid in order["pids"])
        live.is_repeated_by()
    tried = [(who, what, count) for who, each in outcome.items() for what, count in each.items()]
    for who, what, count in tried:
        if count:
            print(f"{who}: {what}: {count}")
    came = sum(1 for *_, count in tried if count)
    print(f"{len(tried)} attacks, something came of {came}; digest equal; at most {grown / 2**20:.1f} MB more memory")
    return int(bool(came) or grown > ALLOWED_BYTES)


def most_bytes(pid: int) -> int:
    """How many bytes a process had at most."""
    return int(re.findall(r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text())[0]) << 10


if __name__ == "__main__":
    sys.exit(main())
