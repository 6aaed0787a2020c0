"""Recordings of hierarchies with rates: what is in them, and that checks and replays find what is wrong with a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.rated_recordings import changes, drawn
from support.recorded import record, record_file

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.unrolled import Unrolled, unrolled_update
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.engine.rated import RatedEngine
from hierax.runtime.execution import single
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.recording.check import Checker, check_recording
from hierax.runtime.recording.diff import compare
from hierax.runtime.recording.info import RunInfo
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.recorder import InProcess, Recorder
from hierax.runtime.recording.replay import Replay, allowance_of, other_settings
from hierax.runtime.recording.topics import MESSAGE, ROSTER, STEP
from hierax.schemas.messages import GREETING, Message, encode_message
from hierax.schemas.steps import NodeStep, Passage
from hierax.schemas.values import encode_value

SEEDS = range(12)
EPOCHS = 40


def is_repeated(recording: Recording, **options: object) -> int:
    """That all epochs are alike in all results and digests; how many there are."""
    first = options.get("first", 1)
    again = Replay(recording, allowance_of(recording), **options)  # type: ignore[arg-type]
    comparison = compare(recording.epochs(first), again.epochs())  # type: ignore[arg-type]
    assert comparison.alike, comparison
    assert comparison.unknown == 0, comparison
    assert comparison.digests == comparison.epochs
    return comparison.epochs


@pytest.mark.parametrize("seed", SEEDS)
def test_a_run_is_recorded_whole_and_is_the_formal_model(seed: int, tmp_path: Path) -> None:
    path = drawn(tmp_path, seed)
    recording, report = record_file(tmp_path / "run.mcap", path, epochs=EPOCHS, seed=seed)
    deployment = read_deployment(path)
    assert deployment.roster.rates is not None
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(seed), deployment.allowance)
    unrolled = Unrolled.initial(hierarchy, deployment.roster.rates)
    for epoch in recording.epochs():
        assert not epoch.lacking
        unrolled = unrolled_update(unrolled)
        doing = {name for name in hierarchy.nodes if deployment.roster.rates.takes_part(name, epoch.epoch)}
        assert epoch.nodes.keys() == doing
        for name in doing:
            assert encode_value(epoch.state_of(name)) == encode_value(unrolled.active.states[name]), (name, epoch.epoch)
            assert epoch.nodes[name].step.digest == unrolled.digests[name]
    assert unrolled.active.epoch == EPOCHS
    assert is_repeated(recording) == is_repeated(recording, world=True) == EPOCHS
    assert check_recording(recording).close() == []
    assert recording.digests()[EPOCHS].hex() == report.digest


@pytest.mark.parametrize("seed", SEEDS)
def test_changes_of_the_roster_are_followed(seed: int, tmp_path: Path) -> None:
    path, schedule = drawn(tmp_path, seed), changes(tmp_path, seed)
    recording, report = record_file(tmp_path / "run.mcap", path, epochs=EPOCHS, seed=seed, at=schedule)
    assert is_repeated(recording) == is_repeated(recording, world=True) == EPOCHS
    assert [*Replay(recording, allowance_of(recording), world=True).epochs()][-1].digest.hex() == report.digest
    for name in ("n0", "n1", "n3", "top"):
        is_repeated(recording, node=name)
    for first in (2, 7, 13, 20, 29):
        assert is_repeated(recording, first=first) == EPOCHS + 1 - first
    assert any(message.header.epoch == GREETING for _, message in recording.messages())


def test_a_node_that_is_replaced_by_its_like_takes_over_before_its_turn(planted: Path, tmp_path: Path) -> None:
    told = 'sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told"'
    top = '  top: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: top}}\nedges:\n'
    planted.write_text(planted.read_text().replace("edges:\n", top) + f"  high -> top: {{{told}}}\n")
    like = tmp_path / "like.yaml"
    like.write_text(
        'nodes:\n  high: {every: 4, offset: 1, class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: high}}\n'
    )
    at = [f"10:replace:high:{like}"]  # its turns are 9 and 13
    recording, _ = record_file(tmp_path / "run.mcap", planted, epochs=30, seed=3, at=at)
    begun = {epoch.epoch: set(epoch.begun) for epoch in recording.epochs() if epoch.begun}
    assert begun == {10: {"high"}}
    for first in (1, 10, 11, 13):
        assert is_repeated(recording, world=True, first=first) == 31 - first


def test_a_recording_of_other_rates_is_what_a_run_with_them_is(tmp_path: Path) -> None:
    slow = ["nodes.motion.every=5", "edges.camera -> motion.delay=3"]
    slower = ["nodes.motion.every=7", "edges.camera -> motion.delay=1"]
    recording, _ = record_file(tmp_path / "run.mcap", "servo", *slow, epochs=30)
    other, wanted = record_file(tmp_path / "other.mcap", "servo", *slower, epochs=30)
    replay = Replay(recording, allowance_of(recording), world=True, rewrite=other_settings(recording.info, slower, {}))
    *_, last = replay.epochs()
    assert last.digest.hex() == wanted.digest
    comparison = compare(recording.epochs(), other.epochs())
    assert {each.path for each in comparison.rosters} == {"nodes.motion.turns[0]", "edges.camera -> motion.delay"}
    assert comparison.difference is not None
    plain, _ = record_file(tmp_path / "plain.mcap", "servo", epochs=30)
    replay = Replay(plain, allowance_of(plain), world=True, rewrite=other_settings(plain.info, slower, {}))
    assert [*replay.epochs()][-1].digest.hex() == wanted.digest


def test_one_node_is_replayed_with_other_parameters_and_turns(tmp_path: Path) -> None:
    slow = ["nodes.motion.every=5", "edges.camera -> motion.delay=3"]
    recording, _ = record_file(tmp_path / "run.mcap", "servo", *slow, epochs=30)
    for setting in ("nodes.motion.every=10", "edges.camera -> motion.delay=0"):
        rewrite = other_settings(recording.info, [setting], {})
        epochs = [*Replay(recording, allowance_of(recording), node="motion", rewrite=rewrite).epochs()]
        assert len(epochs) == 30
    rewrite = other_settings(recording.info, ["nodes.motion.every=4"], {})
    with pytest.raises(HieraxError, match=r"epoch 4 cannot be done again: the obs message camera -> motion of epoch 4"):
        list(Replay(recording, allowance_of(recording), node="motion", rewrite=rewrite).epochs())


# --- what is wrong with a run is found

RATED = """\
hierarchy: planted
world: world
nodes:
  world: {class: "hierax.runtime.sim.nodes:MixingWorld", parameters: {name: world}}
  low: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: low}}
  high: {every: 4, offset: 1, class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: high}}
edges:
  world -> low: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told"}
  low -> high: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: 3, gather: true}
"""


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    path = tmp_path / "planted.yaml"
    path.write_text(RATED)
    return path


def recorded_and_checked(folder: Path, path: Path) -> tuple[Recording, list[str]]:
    """A run in which something may be wrong, and the rules that it breaks."""
    deployment = read_deployment(path)
    recording = InProcess(Recorder(RunInfo.of(deployment, "00000000", "run", 0, (), True), folder / "x.mcap", True))
    single.run(deployment, epochs=30, seed=0, record=recording)
    recording.finish()
    assert recording.checker is not None
    return Recording.open(folder / "x.mcap"), [violation.rule for violation in recording.checker.close()]


def test_a_run_in_good_order_passes(planted: Path, tmp_path: Path) -> None:
    recording, broken = recorded_and_checked(tmp_path, planted)
    assert broken == []
    assert is_repeated(recording) == 30


GROWING = """
hierarchy: growing
world: world
rates: true
nodes:
  world: {class: "hierax.nodes.chain:Counter"}
  arm: {class: "hierax.nodes.chain:Relay"}
edges:
  world -> arm: {sense: "hierax.nodes.chain:count", context: "hierax.nodes.chain:level"}
"""

LATE = """
nodes:
  late: {class: "hierax.nodes.chain:Relay"}
edges:
  world -> late: {sense: "hierax.nodes.chain:count", context: "hierax.nodes.chain:level", delay: 60}
"""


def test_what_counts_late_is_remembered_also_where_it_comes_with_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hierax.runtime.recording.check.KEPT_EPOCHS", 3)
    deployment, snippet = tmp_path / "growing.yaml", tmp_path / "late.yaml"
    deployment.write_text(GROWING, encoding="utf-8")
    snippet.write_text(LATE, encoding="utf-8")
    recording, _ = record_file(tmp_path / "run.mcap", deployment, epochs=140, at=[f"5:attach:{snippet}"])
    assert check_recording(recording).turns["world"].in_force == {"arm": 140, "late": 80}
    assert is_repeated(recording) == 140


@pytest.mark.parametrize("by", [-1, 1])
def test_context_that_counts_in_another_epoch_is_found(
    by: int, planted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn = RatedEngine._turn

    def shifted(engine: RatedEngine, epoch: int, attempt: int) -> None:
        turn(engine, epoch, attempt)
        for slot in engine._counting:
            if (engine.name, slot[0]) in engine._rates.delays:
                engine._counting[slot] = engine._rates.in_force(engine.name, slot[0], epoch + by)

    with monkeypatch.context() as patched:
        patched.setattr(RatedEngine, "_turn", shifted)
        recording, broken = recorded_and_checked(tmp_path, planted)
    assert "EPOCH" in broken
    assert not compare(recording.epochs(), Replay(recording, allowance_of(recording)).epochs()).alike


def test_an_observation_that_is_not_gathered_is_found(
    planted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gather = RatedEngine._gather

    def forgetful(engine: RatedEngine) -> None:
        for elements in engine._gathered.values():
            elements[:] = [each for each in elements if each[0] != 7]
        gather(engine)

    with monkeypatch.context() as patched:
        patched.setattr(RatedEngine, "_gather", forgetful)
        recording, broken = recorded_and_checked(tmp_path, planted)
    assert broken == ["EPOCH"]
    difference = compare(recording.epochs(), Replay(recording, allowance_of(recording)).epochs()).difference
    assert difference is not None
    assert difference[:3] == (9, "high", "observe")


Things = list[Any]


def checked(things: Things) -> set[str]:
    """The rules that recorded things break."""
    checker = Checker()
    for thing in things:
        if isinstance(thing, Message):
            checker.message(encode_message(thing))
        elif isinstance(thing, NodeStep):
            checker.step(thing)
        else:
            checker.roster(thing)
    return {violation.rule for violation in checker.close()}


def restep(things: Things, name: str, epoch: int, change: Callable[[NodeStep], NodeStep]) -> None:
    (index,) = [
        i for i, thing in enumerate(things) if isinstance(thing, NodeStep) and thing[0] == name and thing.epoch == epoch
    ]
    things[index] = change(things[index])


def without(step: NodeStep, *passage: object) -> NodeStep:
    left = tuple(each for each in step.passages if each[: len(passage)] != passage)
    assert len(left) < len(step.passages)
    return step._replace(passages=left)


def unheard(things: Things, name: str, passage: tuple[object, ...]) -> None:
    """No step of a node tells of a message."""
    for index, step in enumerate(things):
        if isinstance(step, NodeStep) and step.name == name:
            passages = tuple(each for each in step.passages if each[: len(passage)] != passage)
            things[index] = step._replace(passages=passages)


def leave_out(things: Things, name: str, epoch: int) -> None:
    """A node takes no part in an epoch, as if it were not its turn."""
    passages: tuple[Passage, ...] = ()
    for index, step in enumerate(things):
        if isinstance(step, NodeStep) and step.name == name and step.epoch == epoch:
            passages = step.passages
        elif isinstance(step, NodeStep) and step.name == name and step.epoch > epoch:
            things[index] = step._replace(number=step.number - 1, passages=passages + step.passages)
            passages = ()
    things[:] = [each for each in things if not (isinstance(each, NodeStep) and each[0] == name and each[3] == epoch)]


def reused(step: NodeStep, kind: str, by: int) -> NodeStep:
    used = tuple((*row[:2], row[2] + by * (row[1] == kind), row[3]) for row in step.used)
    return step._replace(used=used)


def second(things: Things, **fields: object) -> None:
    """A message is said again, perhaps with something else in its header."""
    message = next(
        t for t in things if isinstance(t, Message) and t.header[:2] == ("ctx", "high") and t.header.epoch == 9
    )
    things.append(message._replace(header=message.header._replace(**fields)))  # type: ignore[arg-type]


BROKEN: dict[str, tuple[set[str], Callable[[Things], None]]] = {
    "nothing": (set(), lambda things: None),
    "said again": (set(), second),
    "said again, with another digest": ({"ONCE"}, lambda things: second(things, digest=bytes(32))),
    "another belief": (
        {"DIGEST"},
        lambda things: restep(things, "high", 9, lambda step: step._replace(state=step.state[:-1] + b"\7")),
    ),
    "context an epoch early": ({"EPOCH"}, lambda things: restep(things, "low", 9, lambda s: reused(s, "ctx", 1))),
    "context an epoch late": ({"EPOCH"}, lambda things: restep(things, "low", 9, lambda s: reused(s, "ctx", -1))),
    "not gathered": (
        {"EPOCH"},
        lambda things: restep(things, "high", 9, lambda s: s._replace(used=tuple(r for r in s.used if r[2] != 7))),
    ),
    "without observations of an epoch between": (
        {"SENSE"},
        lambda things: restep(things, "high", 9, lambda s: without(s, False, "obs", "low", 7)),
    ),
    "without what is in force": ({"PREDICT"}, lambda things: unheard(things, "low", (False, "ctx", "high", 5))),
    "a turn left out": ({"TURN"}, lambda things: leave_out(things, "high", 9)),
    "out of turn": ({"TURN"}, lambda things: restep(things, "high", 9, lambda s: s._replace(epoch=10))),
}


@pytest.mark.parametrize("what", BROKEN)
def test_each_rule_notices_what_breaks_it(what: str, planted: Path, tmp_path: Path) -> None:
    recording, _ = record_file(tmp_path / "run.mcap", planted, epochs=20)
    things: Things = []
    for entry in recording.entries(MESSAGE, STEP, ROSTER):
        what_it_is = entry.topic.what
        read = entry.message if what_it_is == MESSAGE else entry.step if what_it_is == STEP else entry.roster
        things.append(read())
    rules, breaks = BROKEN[what]
    breaks(things)
    found = checked(things)
    assert found >= rules
    assert bool(found) == bool(rules)


def test_the_nodes_of_a_recording_tell_in_their_turns_alone(planted: Path, tmp_path: Path) -> None:
    recording, _ = record(tmp_path / "run.mcap", read_deployment(planted), 20)
    assert [step.epoch for step in recording.steps("high")] == [1, 5, 9, 13, 17]
    assert recording.ending is not None
    assert (recording.ending.first, recording.ending.last, recording.ending.lost) == (1, 20, 0)
