"""Peers do the same work in turn; who cannot is told, and nobody outlives the bench."""

import os
import sys
from pathlib import Path

import pytest
from support.launched import is_alive, until

from hierax.runtime.bench import peers
from hierax.runtime.bench.bare_chain import LOW_LATENCY, ORDINARY, SHARED
from hierax.runtime.bench.epoch import PICTURE_BYTES, bare
from hierax.runtime.bench.rivals.stopwatch import Stopwatch


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Ours takes 2 ms, plain Zenoh 1 ms; no rival is installed."""
    monkeypatch.setattr(peers, "ours", lambda epochs, picture, links: [0.002] * epochs)
    monkeypatch.setattr(peers, "bare", lambda epochs, picture, links: [1000.0] * epochs)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    return tmp_path


def install(folder: Path, script: str) -> None:
    """Put a program in the place of a rival's Python."""
    folder.mkdir(parents=True)
    (folder / "python").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "python").chmod(0o755)


def test_who_is_not_installed_or_fails_is_told(known: Path) -> None:
    install(known / "ros" / "bin", "echo no DDS today >&2; exit 1")
    tables = peers.bench_peers(10, 2, lambda line: None)
    assert [(table["work"], table["busy_loops"]) for table in tables] == [
        *((peers.SMALL, 0), (peers.LARGE, 0), (peers.SMALL, 2), (peers.LARGE, 2))
    ]
    for table in tables:
        told = {peer["name"]: peer for peer in table["peers"]}
        assert "make peers" in told["ezmsg"]["missing"]
        assert "make peers" in told["dora"]["missing"]
        assert "no DDS today" in told["ROS 2"]["missing"]
        assert told["hierax, ordinary links"]["ratios"]["plain Zenoh, ordinary links"] == pytest.approx(2.0)


def test_what_a_rival_starts_ends_with_it(known: Path, tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    install(known / "ros" / "bin", f"sleep 1000 > /dev/null & echo $! > {pid}; echo '[4000.0, 4000.0]'")
    ros = peers.bench_peers(10, 1, lambda line: None)[0]["peers"][-1]
    assert ros["p50_us"] == 4000.0
    left = int(pid.read_text())
    until(lambda: not is_alive(left), f"the end of {left}")


def test_repeated_answers_do_not_count() -> None:
    watch = Stopwatch(2)
    assert watch.begin() == (0, 0.0)
    assert watch.end(0)
    assert watch.begin() == (1, 0.5)
    assert not watch.end(0)
    assert not watch.end(1)
    assert watch.done
    assert len(watch.times_us) == 2


@pytest.mark.parametrize(("links", "picture"), [(ORDINARY, PICTURE_BYTES), (LOW_LATENCY, 0), (SHARED, PICTURE_BYTES)])
def test_the_bare_chain_knows_all_links(links: str, picture: int) -> None:
    assert len(bare(100, picture, links)) == 100


@pytest.mark.parametrize("name", peers.RIVALS)
@pytest.mark.parametrize("picture", [0, PICTURE_BYTES])
def test_rivals_do_the_work(name: str, picture: int) -> None:
    module, place = peers.RIVALS[name]
    python = Path(sys.prefix, place, "bin", "python")
    if not os.access(python, os.X_OK):
        pytest.skip(f"{python} is not there")
    assert len(peers._rival(python, module, 100, picture)) == 100
