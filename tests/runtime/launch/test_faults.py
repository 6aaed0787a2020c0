"""Faults: what they are written as, and when they strike."""

from __future__ import annotations

from typing import Any

import pytest

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.execution.member import Member
from hierax.runtime.execution.world_member import WorldMember
from hierax.runtime.launch import faults
from hierax.runtime.launch.faults import INSTANTS, Fault, plant, read_faults


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


class _Engine:
    """Calls a member as an engine does; the member's own methods only tell."""

    def __init__(self, kind: type[Member], monkeypatch: pytest.MonkeyPatch) -> None:
        self.told: list[str] = []
        self.member: Any = kind.__new__(kind)
        self.member.name = "node"
        for name in ("save", "send", "keep", "committed"):
            monkeypatch.setattr(kind, name, self._telling(name), raising=False)
        monkeypatch.setattr(kind, "act", self._act)
        monkeypatch.setattr(faults.os, "kill", lambda pid, number: self.told.append("killed"))

    def _telling(self, name: str) -> Any:
        return lambda member, *arguments: self.told.append(name)

    def _act(self, *arguments: Any) -> None:
        self.member.keep()
        self.told.append("moved")
        self.member.keep()

    def epoch(self) -> list[str]:
        """What happens in one."""
        self.told.clear()
        member = self.member
        member.keep()
        member.send("up")
        member.act(1, ())
        member.committed(None)
        return self.told.copy()


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
    engine = _Engine(WorldMember, monkeypatch)
    plant(engine.member, fault)
    usual = ["keep", "send", "keep", "moved", "keep", "committed"]
    assert engine.epoch() == usual
    assert engine.epoch() == second.split()
    assert engine.epoch() == usual


def test_a_node_has_no_instants_of_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = _Engine(Member, monkeypatch)
    with pytest.raises(HieraxError, match="only the world's process comes to 'commit', not 'node'"):
        plant(engine.member, "commit.before:1")
    plant(engine.member, "save.after:1")
    engine.member.save()
    assert engine.told == ["save", "killed"]
