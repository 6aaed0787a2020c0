"""Large pages for what a process has in its memory, on Linux."""

import ctypes
import re
from collections.abc import Iterator
from pathlib import Path

PAGE_BYTES = 1 << 21  # of a large page: 512 usual ones
_COLLAPSE = 25  # MADV_COLLAPSE, from Linux 6.1 on: at once, where the pages are as they are
_ANONYMOUS = re.compile(r"([0-9a-f]+)-([0-9a-f]+) rw-p 0+ 00:00 0\s*(?:\[heap\])?$")


def into_large_pages() -> int:
    """Have what this process has in its memory lie in large pages from now on, as far as the system knows these; how
    many bytes there are for which it does.

    Who goes through some hundred megabytes again and again would else wait for the processor to find the pages as often
    as for what is in them."""
    try:
        madvise = ctypes.CDLL(None, use_errno=True).madvise
        maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    except (OSError, AttributeError):  # another system
        return 0
    madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return sum(PAGE_BYTES for address in _large_pages(maps) if madvise(address, PAGE_BYTES, _COLLAPSE) == 0)


def _large_pages(maps: str) -> Iterator[int]:
    """Where the large pages begin that lie within the writable memory of no file, by what ``/proc/self/maps`` says."""
    for line in maps.splitlines():
        found = _ANONYMOUS.match(line)
        if found:
            begin, end = (int(address, 16) for address in found.groups())
            yield from range(-(-begin // PAGE_BYTES) * PAGE_BYTES, end - PAGE_BYTES + 1, PAGE_BYTES)
