from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.canvas import KeptCanvas
from support.deployments import replaced, write

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.showing import Curve, Image, Lines2D, Mesh
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution import single
from hierax.runtime.loading.loader import load_function
from hierax.runtime.viewing.live import run_seen
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.viewing.views import ShowError


def seen(name: str | Path, *settings: str, epochs: int | None = None) -> KeptCanvas:
    deployment = read_deployment(name, settings)
    canvas = KeptCanvas()
    spec = deployment.view
    together = None if spec.show is None else load_function(spec.show, "view.show", deployment.allowance)
    run_seen(deployment, ViewPresenter(canvas, spec.layout, together), epochs=epochs, seed=0)
    return canvas


def test_tracking_shows_image_edges_scene_and_errors() -> None:
    canvas = seen("tracking", epochs=3)
    things = {path: each.thing for path, each in canvas.drawn[3].items()}
    image, expected, corrected = (things[f"camera/arm/{name}"] for name in ("image", "expected", "corrected"))
    assert isinstance(image, Image)
    assert isinstance(expected, Lines2D)
    assert isinstance(corrected, Lines2D)
    assert np.asarray(image.pixels).shape == (480, 640, 3)
    red, green = np.asarray(expected.lines), np.asarray(corrected.lines)
    assert len(red) > 50
    assert red.shape == green.shape
    assert 0.0 < np.abs(red - green).max() < 10.0  # pixels
    errors = [things[f"error_mm/together/{number}"] for number in range(1, 7)]
    assert all(isinstance(error, Curve) and 0.0 < error.value < 5.0 for error in errors)
    assert sum(isinstance(thing, Mesh) for thing in things.values()) == 6
    probable = [things[f"probability/arm/{number}"] for number in range(1, 7)]
    assert all(isinstance(each, Curve) and each.value > 0.9 for each in probable)
    assert str(things["arm/why"]).count("### object") == 6
    assert isinstance(things["evidence/arm/for"], Lines2D)
    assert {"scene/arm/camera", "scene/spatial/table", "scene/world/true/1", "imagined/spatial/depth"} <= things.keys()
    assert canvas.names[0] == [["camera", "evidence"], ["imagined"]]
    assert canvas.names[1][0] == ["scene"]


def test_without_context_the_lost_objects_are_named_and_have_no_green_edges() -> None:
    things = seen("tracking", "context=false", epochs=2).drawn[2]
    corrected = things["camera/arm/corrected"].thing
    assert isinstance(corrected, Lines2D)
    assert not np.asarray(corrected.lines).size
    assert {f"camera/arm/names/{number}" for number in range(1, 7)} <= things.keys()
    assert not any(path.startswith("error_mm/") for path in things)


@pytest.mark.parametrize(
    ("name", "paths"),
    [
        ("servo", {"position_m/world/object", "position_m/camera/believed", "error_m/world/camera"}),
        ("letters", {"word/posterior/CAT", "letter2/posterior/A"}),
        ("letters-image", {"letter2/sign/seen", "letter2/posterior/A"}),
        ("chain", {"arm/belief", "hierarchy"}),
    ],
)
def test_other_deployments(name: str, paths: set[str]) -> None:
    canvas = seen(name, epochs=2)
    assert paths <= canvas.drawn[2].keys()
    assert canvas.drawn[2]["epochs/took_ms"].thing > 0.0  # type: ignore[operator]
    assert canvas.layouts


def test_who_looks_changes_nothing() -> None:
    deployment = read_deployment("servo")
    digest = single.run(deployment, epochs=20, seed=3).digest
    assert run_seen(deployment, ViewPresenter(KeptCanvas()), epochs=20, seed=3).digest == digest


def test_what_cannot_be_shown_ends_the_run(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    presenter = ViewPresenter(KeptCanvas(), together=lambda steps: {"sum": steps["nobody"].belief})
    with pytest.raises(ShowError, match=r"^view\.show in epoch 1: KeyError: 'nobody'$"):
        run_seen(deployment, presenter, epochs=3, seed=0)


def test_a_run_that_raises_says_nothing_of_views_that_it_did_not_come_to(tmp_path: Path) -> None:
    told: list[str] = []
    failing = "top.most:\n    class: support.toy_nodes:Failing"
    text = replaced("top.most:\n    class: support.toy_nodes:Summer", failing)
    text = replaced('    parameters:\n      scale: "${scale}"\n      weights: [1, 2.5]\n', "", text)
    deployment = read_deployment(write(tmp_path, text))
    presenter = ViewPresenter(KeptCanvas(), layout=((("shown in the end",),),), notify=told.append)
    with pytest.raises(HieraxError, match="the camera is gone"):
        run_seen(deployment, presenter, epochs=3, seed=0)
    assert told == []
