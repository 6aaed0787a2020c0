from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.execution.single import SingleRun
from hierax.runtime.host import large_pages
from hierax.runtime.host.large_pages import PAGE_BYTES, into_large_pages

MAPS = """\
55d0c0000000-55d0c0500000 rw-p 00000000 00:00 0                          [heap]
7f0000100000-7f0000700000 rw-p 00000000 00:00 0
7f0001000000-7f0001200000 r--p 00000000 00:00 0
7f0002000000-7f0002200000 rw-p 00000000 08:01 99                         /lib/libc.so
7f0003000000-7f00031ff000 rw-p 00000000 00:00 0
7ffc00000000-7ffc00400000 rw-p 00000000 00:00 0                          [stack]
"""
SPREAD = f"""
from hierax.runtime.host.large_pages import into_large_pages
values = [[number] for number in range({PAGE_BYTES // 16})]
print(into_large_pages(), values == [[number] for number in range(len(values))])
"""


def test_whole_large_pages_of_no_file_are_meant() -> None:
    pages = list(large_pages._large_pages(MAPS))
    assert [hex(page) for page in pages] == ["0x55d0c0000000", "0x55d0c0200000", "0x7f0000200000", "0x7f0000400000"]


def test_what_is_in_them_stays() -> None:
    done = subprocess.run([sys.executable, "-c", SPREAD], capture_output=True, text=True, check=True)
    moved, same = done.stdout.split()
    assert same == "True"
    there = Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if int(moved) == 0:
        pytest.skip(f"no large pages here: {there.read_text().strip() if there.exists() else 'no such system'}")
    assert int(moved) % PAGE_BYTES == 0


def test_where_the_system_knows_none_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_pages.ctypes, "CDLL", lambda *_, **__: object())
    assert into_large_pages() == 0


@pytest.mark.parametrize(("many", "times"), [(2, 1), (3, 0)])
def test_hierarchies_of_many_nodes_have_them(many: int, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(single, "MANY", many)
    monkeypatch.setattr(single, "into_large_pages", lambda: asked.append(1))
    list(SingleRun(read_deployment("servo"), epochs=2, seed=0).epochs())
    assert len(asked) == times
