"""A wire between network namespaces: what is sent comes later, some of it never, and hosts can be cut off.

Not every kernel has `tc netem`, so frames go through this program, from a tap device in each namespace. Started as
``python -m support.wire DELAY_MS LOSS NAMESPACE=ADDRESS …``, it says ``up``, and then takes lines: ``cut NAMESPACE``,
``heal NAMESPACE``. It ends with its standard input.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import random
import select
import struct
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress

DEVICE = "wire"
SEED = 1
LONGEST = 1 << 16
_TUNSETIFF, _IFF_TAP, _IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
_CLONE_NEWNET = 0x40000000


def enter(path: str) -> None:
    """Have this process be in a network namespace."""
    where = os.open(path, os.O_RDONLY)
    if ctypes.CDLL(None, use_errno=True).setns(where, _CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), f"setns {path}")
    os.close(where)


def tap_in(namespace: str, address: str) -> int:
    """A descriptor of a new device in a namespace, which is up; this process is in that namespace afterwards."""
    enter(f"/run/netns/{namespace}")
    tap = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    fcntl.ioctl(tap, _TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), _IFF_TAP | _IFF_NO_PI))
    for command in (f"addr add {address}/24 dev {DEVICE}", f"link set {DEVICE} up", "link set lo up"):
        subprocess.run(["ip", *command.split()], check=True)
    return tap


def main() -> None:
    delay_s, loss = float(sys.argv[1]) / 1e3, float(sys.argv[2])
    names = [end.partition("=")[0] for end in sys.argv[3:]]
    home = os.open("/proc/self/ns/net", os.O_RDONLY)
    taps = [tap_in(*end.split("=")) for end in sys.argv[3:]]
    enter(f"/proc/self/fd/{home}")
    cut: set[int] = set()
    known: dict[bytes, int] = {}
    waiting: deque[tuple[float, int, bytes]] = deque()
    drawn = random.Random(SEED)
    print("up", flush=True)
    while True:
        wait_s = None if not waiting else max(waiting[0][0] - time.monotonic(), 0.0)
        ready, _, _ = select.select([0, *taps], [], [], wait_s)
        if 0 in ready:
            word, _, name = sys.stdin.readline().strip().partition(" ")
            if not word:
                return
            (cut.add if word == "cut" else cut.discard)(names.index(name))
            print(word, flush=True)
        for number, tap in enumerate(taps):
            for _ in range(64 if tap in ready else 0):
                try:
                    data = os.read(tap, LONGEST)
                except BlockingIOError:
                    break
                known[data[6:12]] = number
                if number in cut or drawn.random() < loss:
                    continue
                others = (
                    [known[data[:6]]] if data[:6] in known else [each for each in range(len(taps)) if each != number]
                )
                due_s = time.monotonic() + delay_s
                waiting.extend((due_s, other, data) for other in others)
        while waiting and waiting[0][0] <= time.monotonic():
            _, other, data = waiting.popleft()
            if other not in cut:
                with suppress(BlockingIOError):
                    os.write(taps[other], data)


if __name__ == "__main__":
    main()
