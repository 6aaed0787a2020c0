"""The faults of `support.faults`: when they strike."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support import faults
from support.faults import plant, plant_next, written

from hierax.runtime.execution.member import Member
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.transport.port import Port


def test_faults_of_a_node_keep_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = written(tmp_path / "faults", ["arm:send.after:2", "world:keep.before:1", "arm:save.before:9"])
    monkeypatch.setenv(*left.popitem())
    planted: list[str] = []
    monkeypatch.setattr(faults, "plant", lambda text, member, world: planted.append(text))
    arm: Any = SimpleNamespace(name="arm")
    for _ in range(3):
        plant_next(arm, None)
    assert planted == ["send.after:2", "save.before:9"]


class _Process:
    """Calls the parts of a process as an engine does; they only tell."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.told: list[str] = []
        port = SimpleNamespace(send=self._telling("send"))
        self.member: Any = SimpleNamespace(name="node", port=port, save=self._telling("save"))
        self.world: Any = SimpleNamespace(
            write_record=self._telling("keep"), committed=self._telling("committed"), act=self._act
        )
        monkeypatch.setattr(faults.os, "kill", lambda pid, number: self.told.append("killed"))

    def _telling(self, name: str) -> Any:
        return lambda *arguments: self.told.append(name)

    def _act(self, *arguments: Any) -> None:
        self.world.write_record()
        self.told.append("moved")
        self.world.write_record()

    def epoch(self) -> list[str]:
        """What happens in one."""
        self.told.clear()
        self.world.write_record()
        self.member.port.send("up")
        self.world.act(None, 1, ())
        self.world.committed(None)
        return self.told.copy()


def test_the_parts_have_what_faults_are_planted_at() -> None:
    for part, names in ((WorldMember, ("write_record", "committed", "act")), (Member, ("save",)), (Port, ("send",))):
        assert all(callable(getattr(part, name)) for name in names)


@pytest.mark.parametrize(
    ("fault", "second"),
    [
        ("keep.before:2", "killed keep send keep moved keep committed"),
        ("keep.after:2", "keep killed send keep moved keep committed"),
        ("send.before:2", "keep killed send keep moved keep committed"),
        ("send.after:2", "keep send killed keep moved keep committed"),
        ("act.before:2", "keep send killed keep moved keep committed"),
        ("intent.before:2", "keep send killed keep moved keep committed"),
        ("intent.after:2", "keep send keep killed moved keep committed"),
        ("acted.before:2", "keep send keep moved killed keep committed"),
        ("acted.after:2", "keep send keep moved keep killed committed"),
        ("act.after:2", "keep send keep moved keep killed committed"),
        ("commit.before:2", "keep send keep moved keep killed committed"),
        ("commit.after:2", "keep send keep moved keep committed killed"),
    ],
)
def test_a_fault_strikes_at_its_instant_and_once(fault: str, second: str, monkeypatch: pytest.MonkeyPatch) -> None:
    process = _Process(monkeypatch)
    plant(fault, process.member, process.world)
    usual = ["keep", "send", "keep", "moved", "keep", "committed"]
    assert process.epoch() == usual
    assert process.epoch() == second.split()
    assert process.epoch() == usual


def test_a_node_kills_itself_when_it_saves(monkeypatch: pytest.MonkeyPatch) -> None:
    process = _Process(monkeypatch)
    plant("save.after:1", process.member, None)
    process.member.save()
    assert process.told == ["save", "killed"]
