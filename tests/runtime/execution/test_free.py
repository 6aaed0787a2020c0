"""Runs in one process with a staleness, and free running: repeatable, at the nodes' rates, while the roster changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgpack
import pytest
from support.deployments import TOYS, line_of, replaced, write

from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_schedule
from hierax.runtime.execution.report import Report
from hierax.runtime.execution.single import run
from hierax.runtime.transport.port import QUEUE_SIZE

EPOCHS = 60

MIXING = """\
hierarchy: mixing
world: world
nodes:
  world: {class: "hierax.runtime.sim.nodes:MixingWorld", parameters: {name: world}}
  low: {class: "hierax.runtime.sim.nodes:Drawer", parameters: {name: low, policies: 3}}
  mid: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: mid, policies: 2}}
  top: {class: "hierax.runtime.sim.nodes:Drawer", parameters: {name: top}}
edges:
  world -> low: &functions
    sense: {function: "hierax.runtime.sim.nodes:DrawingMix", parameters: {name: sense}}
    task: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: task}}
    context: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: context}}
  world -> mid: *functions
  low -> top: *functions
  mid -> top: *functions
"""
"""Nodes whose every result depends on every input: what was used shows in the digest."""

EXTRA = """\
nodes:
  extra: {class: "hierax.runtime.sim.nodes:Drawer", parameters: {name: extra}}
edges:
  low -> extra:
    sense: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: sense}}
    context: {function: "hierax.runtime.sim.nodes:Mix", parameters: {name: context}}
"""
OTHER = """\
nodes:
  mid: {class: "hierax.runtime.sim.nodes:Mixer", parameters: {name: mid, policies: 2, generation: 9}}
"""

ONE = ("staleness=1",)
FREE = ("staleness=null",)
RATES = ("staleness=null", "nodes.world.rate_hz=50", "nodes.low.rate_hz=25", "nodes.top.rate_hz=5")
WAYS = [ONE, ("staleness=2",), FREE, RATES]


def make(
    folder: Path, overrides: Sequence[str], seed: int = 0, at: Sequence[str] = (), output: Path | None = None
) -> Report:
    """A run of the mixing hierarchy."""
    deployment = read_deployment(write(folder, MIXING), overrides)
    return run(deployment, epochs=EPOCHS, seed=seed, schedule=read_schedule(at, deployment), output=output)


def epochs_of(output: Path, node: str) -> list[int]:
    """The epochs that a node has taken part in."""
    with (output / "states" / f"{node}.msgpack").open("rb") as file:
        return [entry[0] for entry in msgpack.Unpacker(file)]


def test_what_is_attached_has_the_rate_that_its_snippet_says(tmp_path: Path) -> None:
    extra = write(tmp_path, EXTRA.replace("{class", "{rate_hz: 5, class", 1), "extra.yaml")
    make(tmp_path, (*FREE, "nodes.world.rate_hz=50"), at=[f"2:attach:{extra}"], output=tmp_path / "out")
    often, rarely = (len(epochs_of(tmp_path / "out", name)) for name in ("low", "extra"))
    assert 0 < rarely <= often / 4


@pytest.mark.parametrize("overrides", WAYS)
def test_a_seed_fixes_the_run(overrides: Sequence[str], tmp_path: Path) -> None:
    first, again = (make(tmp_path, overrides, seed=3) for _ in range(2))
    assert (first.digest, first.nodes) == (again.digest, again.nodes)
    assert first.epochs == EPOCHS


@pytest.mark.parametrize("overrides", WAYS)
def test_another_seed_is_another_run(overrides: Sequence[str], tmp_path: Path) -> None:
    assert len({make(tmp_path, overrides, seed).digest for seed in range(4)}) == 4


def test_staleness_and_rates_make_a_difference(tmp_path: Path) -> None:
    digests = {make(tmp_path, overrides).digest for overrides in (("staleness=0",), *WAYS)}
    assert len(digests) == 5


def test_what_was_used_is_in_the_metrics(tmp_path: Path) -> None:
    assert "staleness_max" not in make(tmp_path, ("staleness=0",)).nodes["world"].metrics
    metrics = make(tmp_path, ONE).nodes["world"].metrics
    assert 0.0 < metrics["staleness_mean"] <= (EPOCHS - 2) / EPOCHS, "the first epoch and the last are drained"
    assert metrics["staleness_max"] == 1.0


# --- free running


def test_nodes_take_part_at_their_rates(tmp_path: Path) -> None:
    output = tmp_path / "output"
    report = make(tmp_path, RATES, output=output)
    epochs = {name: epochs_of(output, name) for name in report.nodes}
    assert epochs["world"] == list(range(1, EPOCHS + 1))
    assert 0.8 * EPOCHS <= len(epochs["mid"]) <= EPOCHS, "it has no rate: as often as the quickest"
    assert 0.4 * EPOCHS <= len(epochs["low"]) <= 0.6 * EPOCHS
    assert 0.1 * EPOCHS <= len(epochs["top"]) <= 0.2 * EPOCHS
    for name, each in epochs.items():
        assert each[0] == 1, "the first epoch is drained"
        assert each[-1] == EPOCHS, "and the last one"
        assert sorted(set(each)) == each
        assert report.nodes[name].metrics["epochs_left_out"] == EPOCHS - len(each)


def test_without_rates_all_are_as_quick(tmp_path: Path) -> None:
    """A turn takes a period, so what comes from above is at most as old as it is far."""
    nodes = make(tmp_path, FREE).nodes
    assert all(nodes[name].metrics["epochs_left_out"] <= 4 for name in nodes)
    assert 0 < nodes["world"].metrics["staleness_mean"] <= 2


def test_a_run_ends_when_its_world_has_finished(tmp_path: Path) -> None:
    text = replaced('parameters: {step: "${step}"}', "parameters: {last: 40}", replaced("epochs: 3\n", "", TOYS))
    report = run(read_deployment(write(tmp_path, text), FREE), epochs=None, seed=0)
    assert (report.epochs, report.nodes["world"].belief) == (40, 40)


# --- a roster that changes


@pytest.mark.parametrize("overrides", WAYS)
def test_a_roster_that_changes(overrides: Sequence[str], tmp_path: Path) -> None:
    """Attached, replaced and detached under way: also at one epoch, and at the very first and last."""
    extra, other = write(tmp_path, EXTRA, "extra.yaml"), write(tmp_path, OTHER, "other.yaml")
    at = [
        f"1:attach:{extra}",
        f"20:replace:mid:{other}",
        "20:detach:extra",
        f"21:attach:{extra}",
        "40:detach:top",
        "60:attach:top",
    ]
    reports = [make(tmp_path, overrides, at=at, output=tmp_path / str(turn)) for turn in range(2)]
    assert reports[0].digest == reports[1].digest
    assert reports[0].digest != make(tmp_path, overrides, at=at[1:2]).digest
    assert reports[0].epochs == EPOCHS
    assert sorted(reports[0].nodes) == ["extra", "low", "mid", "top", "world"]
    top = epochs_of(tmp_path / "0", "top")
    assert top[-1] == EPOCHS, "it is back"
    extra_epochs = epochs_of(tmp_path / "0", "extra")
    assert {21, 60} <= set(extra_epochs), "a node has a part in the first epoch under its roster"
    for name in ("low", "mid"):
        assert {19, 20, 21, 39, 40, 59, 60} <= set(epochs_of(tmp_path / "0", name)), "drained before, and first after"


@pytest.mark.parametrize("overrides", [ONE, ("staleness=8",)])
def test_changes_in_consecutive_epochs_are_those_of_the_barrier(overrides: Sequence[str], tmp_path: Path) -> None:
    """Every epoch is a drained one then."""
    extra = write(tmp_path, EXTRA, "extra.yaml")
    at = [f"{k}:detach:extra" if k % 2 else f"{k}:attach:{extra}" for k in range(2, EPOCHS + 1)]
    barrier = make(tmp_path, ("staleness=0",), at=at)
    assert make(tmp_path, overrides, at=at).digest == barrier.digest
    assert make(tmp_path, FREE, at=at).digest == barrier.digest


# --- fields


def test_fields_of_the_deployment(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert read_deployment(path).staleness == Staleness(0)
    assert read_deployment(path, ("staleness=3",)).staleness == Staleness(3)
    free = read_deployment(path, ("staleness=null", "nodes.left.rate_hz=2.5"))
    assert free.staleness == Staleness(None)
    assert {name: each.rate_hz for name, each in free.terms.items() if each.rate_hz} == {"left": 2.5}


@pytest.mark.parametrize(
    ("old", "new", "place", "what"),
    [
        ("epochs: 3", "staleness: 1\nexact: true", "exact", "write `delay: n` on the edges"),
        ("epochs: 3", "exact: false", "exact", "write `delay: n` on the edges"),
        ("epochs: 3", "late: skip", "late", "means something only where the world has a rate, with the barrier: node"),
        ("  left: {", "  left: {scheduling: {priority: 20}, ", "scheduling", "means something only with a rea"),
        ("epochs: 3", "staleness: 9", "staleness", "8, got 9"),
        ("epochs: 3", "staleness: -1", "staleness", "expected at least 0, got -1"),
        ("epochs: 3", "staleness: 1.5", "staleness", "a whole number"),
        ("epochs: 3", "staleness: free", "staleness", "expected a whole number, got 'free'"),
        ("  left: {", "  left: {rate_hz: 3, ", "rate_hz", "only in free running (staleness: null)"),
    ],
)
def test_fields_that_are_wrong_are_named_with_their_line(
    old: str, new: str, place: str, what: str, tmp_path: Path
) -> None:
    text = replaced(old, new)
    path = write(tmp_path, text)
    with pytest.raises(DeploymentError) as error:
        read_deployment(path)
    assert str(error.value).startswith(f"{path}:{line_of(place, text)}: ")
    assert what in str(error.value)


def test_what_was_exact_is_a_delay_also_where_it_is_set(tmp_path: Path) -> None:
    with pytest.raises(DeploymentError, match=r"^--set exact=true: .*write `delay: n` on the edges"):
        read_deployment(write(tmp_path), ("staleness=1", "exact=true"))


@pytest.mark.parametrize("rate", ["0", "-1", ".inf", ".nan", "fast"])
def test_a_rate_is_a_positive_number(rate: str, tmp_path: Path) -> None:
    text = replaced("epochs: 3", "staleness: null", replaced("  left: {", f"  left: {{rate_hz: {rate}, "))
    path = write(tmp_path, text)
    with pytest.raises(DeploymentError, match=f"toys.yaml:{line_of('rate_hz', text)}: .*rate_hz"):
        read_deployment(path)


def test_a_node_that_is_much_slower_hears_of_the_newest_epochs(tmp_path: Path) -> None:
    """Between two of its turns go more epochs than messages may wait."""
    rates = ("nodes.world.rate_hz=2000", "nodes.low.rate_hz=2000", "nodes.mid.rate_hz=2000", "nodes.top.rate_hz=1")
    deployment = read_deployment(write(tmp_path, MIXING), ("staleness=null", *rates))
    epochs, output = QUEUE_SIZE + 1500, tmp_path / "out"
    assert run(deployment, epochs=epochs, seed=0, output=output).epochs == epochs
    assert len(epochs_of(output, "top")) <= 4
