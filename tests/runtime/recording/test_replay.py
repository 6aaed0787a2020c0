"""What was recorded is done again to the bit, whole and node by node; other parameters give what they would have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.core.binding import BoundNode, OperatorSetting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.process import ActiveHierarchy, ActiveNode, predict, sense, update
from hierax.runtime.deployment.deployment import shipped
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.info import RecordingError
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.replay import Replay, allowance_of, check_names, other_settings, recorded_deployment
from hierax.schemas.values import encode_value

QUICK = dict.fromkeys(shipped(), ()) | {"tracking": ("frames=3", "cubes=2")}
QUICK |= dict.fromkeys(("pick", "tower"), ("frames=3",))
"""Settings with which a deployment takes little time."""

SNIPPET = """\
nodes:
  side: {class: "support.flawed:Level", parameters: {name: side}}
edges:
  low -> side:
    sense: {function: "support.flawed:Sense", parameters: {name: "low->side"}}
    context: {function: "support.flawed:Context", parameters: {name: "low->side"}}
"""


@pytest.fixture
def flawed(tmp_path: Path) -> Path:
    path = tmp_path / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return path


def is_repeated(recording: Recording, **options: object) -> int:
    """How many epochs are alike, all results and digests."""
    comparison = compare(recording.epochs(), Replay(recording, allowance_of(recording), **options).epochs())  # type: ignore[arg-type]
    assert comparison.alike, comparison
    assert comparison.digests == comparison.epochs
    return comparison.epochs


@pytest.mark.parametrize("name", sorted(shipped()))
def test_every_shipped_deployment_is_repeated(name: str, tmp_path: Path) -> None:
    recording, report = record_file(tmp_path / "run.mcap", name, *QUICK[name], epochs=3)
    assert is_repeated(recording) == report.epochs
    assert is_repeated(recording, world=True) == report.epochs
    last = list(Replay(recording, allowance_of(recording), world=True).epochs())[-1]
    assert last.digest.hex() == report.digest


@pytest.mark.parametrize("settings", [("staleness=2",), ("staleness=null",)])
def test_epochs_that_overlap_are_repeated_from_what_was_used(settings: tuple[str, ...], tmp_path: Path) -> None:
    recording, report = record_file(tmp_path / "run.mcap", "servo", *settings, seed=3)
    assert is_repeated(recording, world=True) == report.epochs


@pytest.mark.parametrize("node", ["world", "low", "high"])
def test_a_node_is_repeated_on_its_recorded_inputs(node: str, flawed: Path, tmp_path: Path) -> None:
    recording, report = record_file(tmp_path / "run.mcap", flawed)
    replay = Replay(recording, allowance_of(recording), node=node)
    assert compare(recording.epochs(), replay.epochs()).alike
    assert replay.states.keys() == {node}
    assert replay.states[node].policy == report.nodes[node].policy


def test_changes_of_the_roster_are_repeated(flawed: Path, tmp_path: Path) -> None:
    side = tmp_path / "side.yaml"
    side.write_text(SNIPPET, encoding="utf-8")
    like = tmp_path / "like.yaml"
    like.write_text('nodes:\n  high: {class: "support.flawed:Level", parameters: {name: high}}\n', encoding="utf-8")
    other = tmp_path / "other.yaml"
    other.write_text('nodes:\n  low: {class: "support.flawed:Level", parameters: {name: low, gain: 0.9}}\n', "utf-8")
    at = [f"3:attach:{side}", f"5:replace:high:{like}", f"6:replace:low:{other}", "8:detach:side", f"10:attach:{side}"]
    recording, report = record_file(tmp_path / "run.mcap", flawed, at=at)
    assert is_repeated(recording) == is_repeated(recording, world=True) == report.epochs
    assert is_repeated(recording, first=7) == 6
    assert sorted(roster.version for roster in recording.rosters().values()) == list(range(6))
    taken = {name: state.belief["taken"] for name, state in _last_states(recording).items() if name != "world"}
    assert taken == {"high": 1, "low": 1, "side": 0}


def _last_states(recording: Recording) -> dict[str, object]:
    replay = Replay(recording, allowance_of(recording), world=True)
    for _ in replay.epochs():
        pass
    return dict(replay.states)


def test_a_replay_from_the_middle_begins_with_recorded_states(flawed: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed)
    epochs = [epoch.epoch for epoch in Replay(recording, allowance_of(recording), first=5, last=9).epochs()]
    assert epochs == [5, 6, 7, 8, 9]
    comparison = compare(recording.epochs(5, 9), Replay(recording, allowance_of(recording), first=5, last=9).epochs())
    assert comparison.alike
    assert comparison.digests == 5


def test_other_parameters_give_what_a_run_with_them_gives(flawed: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed)
    _, wanted = record_file(tmp_path / "wanted.mcap", flawed, "gain=0.9")
    replay = Replay(
        recording, allowance_of(recording), world=True, rewrite=other_settings(recording.info, ["gain=0.9"], {})
    )
    comparison = compare(recording.epochs(), replay.epochs())
    assert [each.path for each in comparison.rosters] == ["nodes.low.parameters.gain"]
    assert comparison.difference is not None
    assert comparison.difference[:4] == (1, "low", "observe", "belief.level")
    *_, last = Replay(
        recording, allowance_of(recording), world=True, rewrite=other_settings(recording.info, ["gain=0.9"], {})
    ).epochs()
    assert last.digest.hex() == wanted.digest


def test_another_class_takes_a_nodes_place(flawed: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed, epochs=2)
    rewrite = other_settings(recording.info, (), {"high": "support.toy_nodes:Counter"})
    allowed = allowance_of(recording).with_modules(["support.toy_nodes"])
    with pytest.raises(HieraxError, match=r"nodes\.high\.parameters\.name: support\.toy_nodes:Counter has no such"):
        list(Replay(recording, allowed, rewrite=rewrite).epochs())


def test_the_recorded_deployment_needs_no_file(flawed: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed)
    flawed.unlink()
    assert other_settings(recording.info, ["gain=0.1"], {}) is not None
    assert is_repeated(recording) == 12


def test_a_node_that_is_not_there_is_named(flawed: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed, epochs=1)
    with pytest.raises(RecordingError, match="there is no node 'hihg'; did you mean 'high'"):
        check_names(recording, ["hihg"])


def test_a_replay_is_the_formal_process_model(flawed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", flawed)
    deployment = recorded_deployment(recording.info)
    setting = OperatorSetting(recording.info.seed)
    active = ActiveHierarchy.initial(build_hierarchy(deployment.roster, setting, deployment.allowance))
    updated: list[str] = []
    for core in (sense, predict):

        def counted(bound: BoundNode, *given: Any, core: Callable[..., ActiveNode] = core) -> ActiveNode:
            updated.append(f"{core.__name__} {bound.name}")
            return core(bound, *given)

        monkeypatch.setattr(f"hierax.runtime.recording.replay.{core.__name__}", counted)
    order = active.hierarchy.order
    for replayed in Replay(recording, allowance_of(recording), world=True).epochs():
        assert updated == [*(f"sense {name}" for name in order), *(f"predict {name}" for name in reversed(order))]
        updated.clear()
        active = update(active)
        assert encode_value(replayed.states) == encode_value({name: active.states[name] for name in replayed.states})
    assert active.epoch == 12
