"""What a deployment file may say of rates."""

from __future__ import annotations

from pathlib import Path

import pytest

from hierax.runtime.deployment.deployment import DeploymentError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_attach
from hierax.schemas.rates import Rates, Turns

EDGE = "edges.camera -> motion"


def test_rates_are_by_node_and_edge() -> None:
    said = ["nodes.motion.every=4", "nodes.motion.offset=3", f"{EDGE}.delay=2", f"{EDGE}.gather=true"]
    pair = ("camera", "motion")
    expected = Rates({"motion": Turns(4, 3)}, {pair: 2}, frozenset({pair}))
    roster = read_deployment("servo", said).roster
    assert roster.rates == expected
    plain, may = read_deployment("servo").roster, read_deployment("servo", ["rates=true"]).roster
    assert plain.rates is None
    assert may.rates == Rates()
    assert may.content_hash() == plain.content_hash() != roster.content_hash()


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        (["nodes.motion.every=0"], "expected at least 1, got"),
        (["nodes.motion.every=2.5"], "expected a whole number"),
        (["nodes.motion.offset=1"], "nodes.motion.offset: expected less than every, 1, as it is not given here, got 1"),
        (["nodes.motion.every=3", "nodes.motion.offset=3"], "nodes.motion.offset: expected less than every, 3, got 3"),
        (
            ["nodes.motion.every=3", "rates=false"],
            "rates: expected true, or nothing, as there are rates: nodes.motion.e",
        ),
        ([f"{EDGE}.delay=3", "rates=false"], f"rates: expected true, or nothing, as there are rates: {EDGE}.delay"),
        (["nodes.world.every=2"], "nodes.world.every: the world takes part in every epoch; expected 1, got 2"),
        ([f"{EDGE}.delay=-1"], "expected at least 0, got"),
        (["edges.world -> camera.gather=yes please"], "expected true or false"),
        ([f"{EDGE}.sense=null", f"{EDGE}.gather=true"], "means something only with a function 'sense'"),
        (["nodes.motion.every=2", "staleness=1"], "nodes.motion.every: goes with a staleness of 0 only"),
        ([f"{EDGE}.delay=2", "staleness=null"], "delay: goes with a staleness of 0 only"),
    ],
)
def test_what_means_nothing_is_told_in_a_line(settings: list[str], what: str) -> None:
    with pytest.raises(DeploymentError) as raised:
        read_deployment("servo", settings)
    assert what in str(raised.value)
    assert "\n" not in str(raised.value)


def test_nodes_that_join_a_run_may_have_rates(tmp_path: Path) -> None:
    snippet = tmp_path / "more.yaml"
    snippet.write_text(
        'nodes:\n  more: {class: "hierax.nodes.servo:MotionNode", every: 3, offset: 1}\n'
        "edges:\n  camera -> more: {sense: hierax.nodes.servo:position, delay: 2, gather: true}\n"
    )
    attach = read_attach(snippet, read_deployment("servo"))
    assert attach.turns == {"more": Turns(3, 1)}
    assert [(edge.delay, edge.gather) for edge in attach.edges] == [(2, True)]
    snippet.write_text(snippet.read_text().replace("sense: hierax.nodes.servo:position, ", ""))
    with pytest.raises(DeploymentError, match=r"more\.yaml:4: edges\.camera -> more\.gather: means something only"):
        read_attach(snippet, read_deployment("servo"))
