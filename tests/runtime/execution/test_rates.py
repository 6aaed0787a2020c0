"""`run` of deployments with rates, and whatever does not know them yet."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.direct import Direct

from hierax.nodes.servo import CameraNode, MeasuredPosition, MotionNode, SlidingWorld, camera_task, position
from hierax.runtime.commands.main import main
from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.digest import DigestChain
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.rates import Rates, Turns
from hierax.runtime.deployment.deployment import DeploymentError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_schedule
from hierax.runtime.execution.dry import run_dry
from hierax.runtime.execution.single import SingleRun, run
from hierax.runtime.launch.supervisor import launch
from hierax.runtime.loading.loader import build_hierarchy
from hierax.runtime.loading.node_loader import wait_for
from hierax.runtime.scripting.hierarchy import Hierarchy

MOTION = "edges.camera -> motion"
SLOW = ("nodes.motion.every=5", "nodes.motion.offset=2", f"{MOTION}.delay=3")


@pytest.mark.parametrize("settings", [SLOW, SLOW[:1], (f"{MOTION}.delay=4",)])
def test_a_run_is_what_the_direct_implementation_says(settings: tuple[str, ...]) -> None:
    deployment = read_deployment("servo", settings)
    report = run(deployment, epochs=20, seed=3)
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(3, wait_for), deployment.allowance)
    direct, chain = Direct(hierarchy, deployment.rates), DigestChain(deployment.roster.content_hash())
    for epoch in range(1, 21):
        chain.commit(epoch, direct.digest("world", epoch))
    assert report.digest == chain.digest.hex()
    assert report.nodes["motion"].belief == direct.after("motion", 20).belief


def test_rates_change_the_digest_and_no_rates_do_not() -> None:
    plain = run(read_deployment("servo"), epochs=10, seed=0)
    said = run(read_deployment("servo", ["nodes.motion.every=1", f"{MOTION}.delay=0"]), epochs=10, seed=0)
    slow = run(read_deployment("servo", SLOW), epochs=10, seed=0)
    assert plain.digest == said.digest != slow.digest


def test_a_dry_run_goes_on_until_every_node_has_taken_part() -> None:
    every_epoch = run_dry(read_deployment("servo"))
    assert run_dry(read_deployment("servo", ["nodes.motion.every=7"])) > every_epoch


def test_a_launch_refuses_what_it_does_not_know_with_rates_before_it_starts_anything(tmp_path: Path) -> None:
    output = tmp_path / "output"
    deployment = read_deployment("servo", [*SLOW, "nodes.camera.on_loss=detach"])
    with pytest.raises(DeploymentError, match="'on_loss: detach' does not know them yet") as raised:
        launch(deployment, epochs=3, seed=0, output=output)
    assert str(raised.value).startswith("--set nodes.motion.every=5: nodes.motion.every: ")
    assert not output.exists()


def test_rates_do_not_go_with_links_that_carry_few_messages() -> None:
    with pytest.raises(DeploymentError, match="low_latency: goes without rates only"):
        read_deployment("servo", [*SLOW, "low_latency=true"])


def test_changes_and_nodes_that_fail_alone_are_refused() -> None:
    deployment = read_deployment("servo", SLOW)
    with pytest.raises(DeploymentError, match="--at"):
        run(deployment, epochs=3, seed=0, schedule=read_schedule(["2:detach:motion"], deployment))
    with pytest.raises(DeploymentError, match="on_loss: detach"):
        run(read_deployment("servo", [*SLOW, "nodes.camera.on_loss=detach"]), epochs=3, seed=0)
    single = SingleRun(deployment, epochs=3, seed=0)
    change = read_schedule(["2:detach:motion"], deployment)[0].change
    with pytest.raises(HieraxError, match="a change of a run"):
        single.change(change, {})
    single.close()


def test_a_hierarchy_in_python_may_have_rates() -> None:
    hierarchy = Hierarchy("slow").add("world", SlidingWorld).add("camera", CameraNode)
    hierarchy.add("motion", MotionNode, every=4).join("world", "camera", sense=MeasuredPosition, task=camera_task)
    hierarchy.join("camera", "motion", sense=position, context=position, delay=2, gather=True)
    pair = ("camera", "motion")
    assert hierarchy.deployment().rates == Rates({"motion": Turns(4)}, {pair: 2}, frozenset({pair}))
    assert "hierax.nodes.servo:position" in hierarchy.targets()


def test_a_recording_is_refused_and_leaves_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "run.mcap"
    assert main(["run", "servo", "--set", SLOW[0], "--record", str(target)]) != 0
    assert "a recording does not know them" in capsys.readouterr().err
    assert not target.exists()
