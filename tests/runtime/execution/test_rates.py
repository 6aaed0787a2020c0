"""`run` of deployments with rates, and whatever does not know them yet."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml
from support.direct import Direct, Period
from support.partitions import random_deployment, with_rates

from hierax.nodes.servo import CameraNode, MeasuredPosition, MotionNode, SlidingWorld, camera_task, position
from hierax.runtime.commands.main import main
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import DigestChain
from hierax.runtime.deployment.deployment import Deployment, DeploymentError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_schedule
from hierax.runtime.execution.dry import run_dry
from hierax.runtime.execution.single import SingleRun, run
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.loading.node_loader import wait_for
from hierax.runtime.scripting.hierarchy import Hierarchy
from hierax.schemas.rates import Rates, Turns

MOTION = "edges.camera -> motion"


def rates_in(deployment: Deployment) -> Rates:
    assert deployment.roster.rates is not None
    return deployment.roster.rates


def check_as_direct(deployment: Deployment, epochs: int, seed: int) -> None:
    """The digest of `run`, and what every node believes at the end."""
    report = run(deployment, epochs=epochs, seed=seed)
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(seed, wait_for), deployment.allowance)
    direct, chain = Direct(hierarchy, rates_in(deployment)), DigestChain(deployment.roster.content_hash())
    for epoch in range(1, epochs + 1):
        chain.commit(epoch, direct.digest(deployment.roster.world, epoch))
    assert report.digest == chain.digest.hex(), f"seed {seed}"
    for name, node in report.nodes.items():
        assert node.belief == direct.after(name, epochs).belief, f"seed {seed}, {name}"


SLOW = ("nodes.motion.every=5", "nodes.motion.offset=2", f"{MOTION}.delay=3")


@pytest.mark.parametrize("settings", [SLOW, SLOW[:1], (f"{MOTION}.delay=4",)])
def test_a_run_is_what_the_direct_implementation_says(settings: tuple[str, ...]) -> None:
    check_as_direct(read_deployment("servo", settings), 20, 3)


@pytest.mark.parametrize("seed", range(25))
def test_a_run_of_any_hierarchy_is_what_the_direct_implementation_says(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    file = tmp_path / "rated.yaml"
    file.write_text(yaml.safe_dump(with_rates(rng, random_deployment(rng)), sort_keys=False))
    check_as_direct(read_deployment(file), 20, seed)


def test_rates_change_the_digest_and_no_rates_do_not() -> None:
    plain = run(read_deployment("servo"), epochs=10, seed=0)
    said = run(read_deployment("servo", ["nodes.motion.every=1", f"{MOTION}.delay=0"]), epochs=10, seed=0)
    slow = run(read_deployment("servo", SLOW), epochs=10, seed=0)
    assert plain.digest == said.digest != slow.digest


def test_a_dry_run_goes_on_until_every_node_has_taken_part() -> None:
    every_epoch = run_dry(read_deployment("servo"))
    assert run_dry(read_deployment("servo", ["nodes.motion.every=7"])) > every_epoch


def test_a_node_with_rates_does_not_fail_alone() -> None:
    with pytest.raises(DeploymentError, match=r"on_loss: detach means nothing here: where nodes have rates") as raised:
        read_deployment("servo", [*SLOW, "nodes.camera.on_loss=detach"])
    assert str(raised.value).startswith("--set nodes.camera.on_loss=detach: nodes.camera.on_loss: ")


def test_rates_do_not_go_with_links_that_carry_few_messages() -> None:
    with pytest.raises(DeploymentError, match="low_latency: goes without rates only"):
        read_deployment("servo", [*SLOW, "low_latency=true"])


def snippet(folder: Path, rates: str = "", edge: str = "") -> str:
    """The path of a file with another node of motion, and its edge where something is said of that."""
    path = folder / "motion.yaml"
    text = f'nodes:\n  motion: {{class: "hierax.nodes.servo:MotionNode"{rates}}}\n'
    if edge:
        position = "hierax.nodes.servo:position"
        text += f"edges:\n  camera -> motion: {{sense: {position}, context: {position}, {edge}}}\n"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize(
    ("rates", "edge", "then"),
    [
        (", every: 2", "", Rates({"motion": Turns(2)}, {("camera", "motion"): 3})),
        (", every: 1", "delay: 0", Rates()),
        ("", "delay: 7", Rates({"motion": Turns(5, 2)}, {("camera", "motion"): 7})),
        ("", "", Rates({"motion": Turns(5, 2)}, {("camera", "motion"): 3})),
    ],
)
def test_what_replaces_a_node_keeps_its_rates_or_brings_others(
    rates: str, edge: str, then: Rates, tmp_path: Path
) -> None:
    deployment = read_deployment("servo", SLOW)
    path = snippet(tmp_path, rates, edge)
    schedule = read_schedule([f"12:replace:motion:{path}"], deployment)
    report = run(deployment, epochs=25, seed=3, schedule=schedule)
    setting = OperatorSetting(3, wait_for)
    before, after = (build_hierarchy(deployment.roster, setting, deployment.allowance) for _ in range(2))
    direct = Direct(before, rates_in(deployment), Period(12, after, then, frozenset({"motion"})))
    assert report.nodes["motion"].belief == direct.after("motion", 25).belief
    assert report.nodes["camera"].belief == direct.after("camera", 25).belief


def test_a_run_without_rates_gets_none_but_where_its_file_says_so(tmp_path: Path) -> None:
    schedule = [f"5:replace:motion:{snippet(tmp_path, ', every: 2')}"]
    with pytest.raises(DeploymentError, match=r"no node has rates in this run; 'rates: true' in its deployment file"):
        read_schedule(schedule, read_deployment("servo"))
    deployment = read_deployment("servo", ["rates=true"])
    plain = run(read_deployment("servo"), epochs=10, seed=0)
    assert run(deployment, epochs=10, seed=0).digest == plain.digest
    changed = run(deployment, epochs=10, seed=0, schedule=read_schedule(schedule, deployment))
    assert changed.digest != plain.digest


def test_a_change_of_a_run_that_goes_on_takes_effect_after_a_drained_epoch() -> None:
    deployment = read_deployment("servo", SLOW)
    single = SingleRun(deployment, epochs=20, seed=0)
    epochs = single.epochs()
    while next(epochs)[0] < 7:
        pass
    schedule = read_schedule(["2:detach:motion"], deployment)
    first = single.change(schedule[0].change, {})
    assert [epoch for epoch, _ in epochs] == list(range(8, 21))
    again = read_schedule([f"{first}:detach:motion"], deployment)
    assert single.report().digest == run(deployment, epochs=20, seed=0, schedule=again).digest


def test_a_hierarchy_in_python_may_have_rates() -> None:
    hierarchy = Hierarchy("slow").add("world", SlidingWorld).add("camera", CameraNode)
    hierarchy.add("motion", MotionNode, every=4).join("world", "camera", sense=MeasuredPosition, task=camera_task)
    hierarchy.join("camera", "motion", sense=position, context=position, delay=2, gather=True)
    pair = ("camera", "motion")
    assert rates_in(hierarchy.deployment()) == Rates({"motion": Turns(4)}, {pair: 2}, frozenset({pair}))
    assert "hierax.nodes.servo:position" in hierarchy.targets()


def test_what_knew_no_rates_takes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = str(tmp_path / "run.mcap")
    settings = [word for setting in SLOW for word in ("--set", setting)]
    assert main(["run", "servo", *settings, "--epochs", "30", "--record", target, "--check"]) == 0
    for words in (["replay", target, "--verify"], ["diff", target, "servo", *settings], ["inspect", "motion", target]):
        assert main(words) == 0, capsys.readouterr().err
    capsys.readouterr()
    assert main(["check", target]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{target}: 30 epochs, 66 steps of nodes: the formal order is kept",
        "  camera: 30 epochs, the last one 30, with motion 27",
        "  motion: 6 epochs, the last one 27",
        "  world: 30 epochs, the last one 30, with camera 30",
    ]
    assert main(["diff", target, "servo", "--set", "nodes.motion.every=2"]) == 1
    assert "rosters differ from epoch 1: nodes.motion.turns" in capsys.readouterr().out
    assert main(["inspect", "motion", target, "--epoch", "25"]) == 1
    assert (
        "what motion did in epoch 25 is not in it; it took part in epoch 22 last before that" in capsys.readouterr().err
    )
    assert main(["export", "systemd", "servo", *settings, "-o", str(tmp_path / "units")]) == 0
