from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="the extra [view] is not installed")

from hierax.runtime.core.showing import (
    Axes,
    Box,
    Camera,
    Curve,
    Depth,
    Graph,
    Image,
    Labels,
    Lines2D,
    Lines3D,
    Mesh,
    Points2D,
    Points3D,
)
from hierax.runtime.viewing.rerun_canvas import RerunCanvas, archetypes
from hierax.runtime.viewing.views import Column, Kind, View, placed

IMAGE = np.zeros((4, 6, 3), np.uint8)
CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
THINGS: dict[str, Any] = {
    "/camera/image": Image(IMAGE),
    "/camera/grey": Image(IMAGE[..., 0]),
    "/camera/depth": Depth(np.ones((4, 6))),
    "/camera/nothing near": Depth(np.zeros((4, 6))),
    "/camera/labels": Labels(np.arange(24).reshape(4, 6), {1: "cube"}, {1: (1, 2, 3)}),
    "/camera/points": Points2D([[1, 2]], (255, 0, 0), labels=("here",)),
    "/camera/lines": Lines2D([[[0, 0], [1, 1]]]),
    "/camera/none": Lines2D([]),
    "/scene/points": Points3D(CORNERS),
    "/scene/lines": Lines3D([CORNERS]),
    "/scene/mesh": Mesh(CORNERS, [[0, 1, 2]]),
    "/scene/flat": Mesh(CORNERS, [[0, 0, 0]]),
    "/scene/box": Box([1, 2, 3], label="box"),
    "/scene/full": Box([1, 2, 3], filled=True),
    "/scene/axes": Axes(np.eye(4)),
    "/scene/camera": Camera(np.eye(4), [5, 5, 3, 2], (6, 4), IMAGE),
    "/scene/blind": Camera(np.eye(4), [5, 5, 3, 2], (6, 4)),
    "/plot/curve": Curve(0.5, (1, 2, 3)),
    "/plot/number": np.float32(0.5),
    "/plot/flag": True,
    "/text/belief": "**bold**",
    "/graph/tree": Graph({"a": "A", "b": "B"}, [("a", "b")], {"a": (0, 0), "b": (1, 1)}, {"a": (1, 2, 3)}),
    "/graph/loose": Graph({"a": "A"}, directed=False),
}


class KeptStream:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.logged: list[tuple[int, str, str]] = []
        self.blueprints: list[Any] = []
        self._epoch = 0

    def set_time(self, timeline: str, sequence: int = 0, duration: float = 0.0) -> None:
        if timeline == "epoch":
            self._epoch = sequence

    def log(self, path: str, *things: Any, static: bool = False) -> None:
        self.logged += [(0 if static else self._epoch, path, type(thing).__name__) for thing in things]

    def send_blueprint(self, blueprint: Any) -> None:
        self.blueprints.append(blueprint)


def canvas() -> tuple[KeptStream, RerunCanvas]:
    stream = KeptStream()
    return stream, RerunCanvas(stream)  # type: ignore[arg-type]


def test_all_things_go_into_a_file(tmp_path: Path) -> None:
    from hierax.runtime.viewing.viewer import file, stream_of

    path = tmp_path / "some" / "file.rrd"
    stream = stream_of("test")
    with file(stream, path) as place:
        drawing = RerunCanvas(stream)
        for epoch in (1, 2):
            drawing.draw(epoch, 0.1 * epoch, placed("node", THINGS, "here"))
        drawing.clear(3, 0.3, ["scene/node/mesh"])
        kinds = {"camera": Kind.PICTURE, "scene": Kind.SCENE, "plot": Kind.PLOT, "text": Kind.TEXT, "graph": Kind.GRAPH}
        views = [View(name, kind) for name, kind in kinds.items()]
        drawing.arrange((Column(((views[0],), (views[1], views[2])), 3.0), Column(((views[3],), (views[4],)), 2.0)))
    assert place.name == str(path)
    content = path.read_bytes()
    assert content.startswith(b"RRF2")
    for name in ("camera", "scene", "plot", "text", "graph"):
        assert f"/{name}/node".encode() in content


def test_a_curves_look_is_said_once_and_a_mesh_when_it_changes() -> None:
    stream, drawing = canvas()
    mesh = Mesh(CORNERS, [[0, 1, 2]])
    for epoch in (1, 2):
        drawing.draw(epoch, 0.0, placed("a", {"/scene/m": mesh, "/plot/x": 1.0}, "here"))
    drawing.draw(3, 0.0, placed("a", {"/scene/m": Mesh(CORNERS, [[0, 2, 1]])}, "here"))
    drawing.clear(4, 0.0, ["scene/a/m"])
    drawing.draw(5, 0.0, placed("a", {"/scene/m": Mesh(CORNERS, [[0, 2, 1]])}, "here"))
    assert [(epoch, kind) for epoch, path, kind in stream.logged if path == "scene/a/m"] == [
        (1, "Transform3D"),
        (1, "Mesh3D"),
        (2, "Transform3D"),
        (3, "Transform3D"),
        (3, "Mesh3D"),
        (4, "Clear"),
        (5, "Transform3D"),
        (5, "Mesh3D"),
    ]
    assert [(epoch, kind) for epoch, path, kind in stream.logged if path == "plot/a/x"] == [
        (0, "SeriesLines"),
        (0, "SeriesPoints"),
        (1, "Scalars"),
        (2, "Scalars"),
    ]


def test_what_a_thing_has_no_more_is_cleared() -> None:
    stream, drawing = canvas()
    seen = {
        "/scene/eye": Camera(np.eye(4), [5, 5, 3, 2], (6, 4), IMAGE),
        "/scene/it": Mesh(CORNERS, [[0, 1, 2]]),
        "/scene/points": Points3D(CORNERS, labels=("a", "b", "c")),
        "/scene/box": Box([1, 1, 1]),
    }
    then = {
        "/scene/eye": Camera(np.eye(4), [5, 5, 3, 2], (6, 4)),
        "/scene/it": Box([1, 1, 1]),
        "/scene/points": Points3D(CORNERS),
        "/scene/box": Box([2, 1, 1]),
    }
    for epoch, things in enumerate((seen, seen, then, then), start=1):
        drawing.draw(epoch, 0.0, placed("a", things, "here"))
    cleared = [(epoch, path) for epoch, path, kind in stream.logged if kind == "Clear"]
    assert cleared == [(3, f"scene/a/{name}") for name in ("eye", "eye/image", "it", "points")]
    kinds = [kind for epoch, path, kind in stream.logged if (epoch, path) == (3, "scene/a/it")]
    assert kinds == ["Clear", "Transform3D", "Boxes3D"], "cleared before it is drawn anew"


def test_a_path_with_spaces_is_written_as_rerun_reads_it() -> None:
    stream, drawing = canvas()
    drawing.draw(1, 0.0, placed("a", {"plot/on 3 1": 1.0}, "here"))
    drawing.clear(2, 0.0, ["a/plot/on 3 1"])
    assert {path for _, path, _ in stream.logged} == {"a/plot/on\\ 3\\ 1"}


def test_a_camera_has_its_image_below_it() -> None:
    parts = [(below, type(part).__name__) for below, part in archetypes(THINGS["/scene/camera"])]
    assert parts == [("", "Transform3D"), ("", "Pinhole"), ("/image", "EncodedImage")]


def test_nothing_warns(recwarn: pytest.WarningsRecorder) -> None:
    for thing in THINGS.values():
        archetypes(thing)
    assert not list(recwarn)
