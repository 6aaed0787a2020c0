"""Faults: what they are written as, and when they strike."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch import faults
from hierax.runtime.launch.faults import INSTANTS, Fault, plant, read_faults
from hierax.runtime.transport.port import Port


def test_all_instants_can_be_named() -> None:
    assert len(INSTANTS) == 14
    for instant in INSTANTS:
        place, _, side = instant.partition(".")
        assert Fault.read(f"{instant}:3") == Fault(place, side == "before", 3)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("send.befor:1", "'send.befor' is no instant; did you mean 'send.before'?"),
        ("send:1", "'send' is no instant"),
        ("send.before", "'' is no instant"),
        ("send.before:0", "expected INSTANT:N with N from 1"),
        ("send.before:-1", "expected INSTANT:N with N from 1"),
        ("send.before:x", "expected INSTANT:N with N from 1"),
    ],
)
def test_what_is_no_fault_is_refused(text: str, what: str) -> None:
    with pytest.raises(HieraxError, match=f"--fault {text}: ") as error:
        Fault.read(text)
    assert what in str(error.value)


def test_faults_of_a_node_keep_their_order() -> None:
    said = ["arm:send.after:2", "world:keep.before:1", "arm:save.before:9"]
    assert read_faults(said) == {"arm": ["send.after:2", "save.before:9"], "world": ["keep.before:1"]}


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


def test_a_node_has_no_instants_of_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    process = _Process(monkeypatch)
    with pytest.raises(HieraxError, match="only the world's process comes to 'commit', not 'node'"):
        plant("commit.before:1", process.member, None)
    plant("save.after:1", process.member, None)
    process.member.save()
    assert process.told == ["save", "killed"]
