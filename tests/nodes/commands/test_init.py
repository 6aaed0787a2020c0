"""``hierax init``: corners that are clicked in a browser give first poses from which a scene is tracked."""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from support import chromium
from support.launched import Command, said_here

from hierax.nodes.tracking.clicking.model_view import corners_of
from hierax.nodes.tracking.clicking.page import HOST, Page
from hierax.nodes.tracking.clicking.session import Session
from hierax.nodes.tracking.datasets.bop import FIRST_POSES, BopScene, read_results
from hierax.nodes.tracking.datasets.first_poses import objects_of
from hierax.nodes.tracking.datasets.truth import TruePose, read_truth
from hierax.nodes.tracking.evaluation.scoring import object_errors
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.nodes.tracking.math.geometry import Floats, invert, pose_error, project, transform
from hierax.nodes.tracking.model.shapes import shape_of
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.single import run

SEED = 3
FRAMES = 30
TIMEOUT_S = 120.0


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("clicked")
    write_scene(out, "scattered", SEED, FRAMES, False, 2)
    return out


@pytest.fixture
def scene(dataset: Path, tmp_path: Path) -> Path:
    """A scene of which no first pose is told."""
    copy = tmp_path / "dataset"
    shutil.copytree(dataset, copy)
    folder = copy / "test" / "000001"
    (folder / "scene_gt.json").write_text(json.dumps({"0": [{"obj_id": 1, "pose": None}, {"obj_id": 2, "pose": None}]}))
    return folder


def truth_of(scene: Path) -> list[TruePose]:
    return read_truth(scene.parent.parent / "truth" / scene.name)[0]


class Clicker:
    """Knows where each corner is in the first picture, and clicks a pixel beside it."""

    def __init__(self, scene: Path) -> None:
        read = BopScene(scene)
        self._intrinsics = read.frames[0].intrinsics
        self._poses = {each.obj_id: each.pose for each in truth_of(scene)}
        self._shapes = {number: shape_of(*read.model(number)[0]) for number in self._poses}
        self._rng = np.random.default_rng(SEED)

    def answer(self, state: dict[str, Any]) -> Floats | None:
        """The pixel of the corner that is asked for; None: it is not to be seen."""
        number = int(state["object"].rpartition(" ")[2])
        pose, shape = self._poses[number], self._shapes[number]
        corner = corners_of(shape)[state["corner"] - 1]
        away = shape.vertices[shape.faces[:, 0]] - invert(pose)[:3, 3]
        seen = np.einsum("nk,nk->n", shape.normals, away) < 0.0
        at = np.linalg.norm(shape.vertices[shape.faces] - corner, axis=2).min(axis=1) < 1e-6
        if not (seen & at).any():
            return None
        pixel: Floats = project(transform(pose, corner), self._intrinsics) + self._rng.normal(0.0, 1.0, 2)
        return pixel


class Browser:
    """A page on which a user clicks."""

    def __init__(self, page: chromium.Page) -> None:
        self._page = page

    def value(self, script: str) -> Any:
        found = self._page.call("Runtime.evaluate", expression=f"JSON.stringify({script})")["result"]
        return json.loads(found["value"])

    def state(self) -> dict[str, Any]:
        patience = time.monotonic() + TIMEOUT_S
        while self.value("busy || !state"):
            assert time.monotonic() < patience, "the page waits"
            time.sleep(0.01)
        return dict(self.value("state"))

    def press(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self._page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def click(self, pixel: Floats) -> None:
        left, top, scale = self.value("(b => [b.left, b.top, b.width / scene.width])(scene.getBoundingClientRect())")
        self.press(left + scale * (pixel[0] + 0.5), top + scale * (pixel[1] + 0.5))

    def button(self, name: str) -> None:
        left, top, width, height = self.value(
            f"(b => [b.left, b.top, b.width, b.height])(at('{name}').getBoundingClientRect())"
        )
        self.press(left + width / 2, top + height / 2)


@pytest.mark.slow
@pytest.mark.skipif(chromium.PROGRAM is None, reason="chromium is not installed")
def test_clicked_corners_are_first_poses_from_which_a_scene_is_tracked(scene: Path, tmp_path: Path) -> None:
    clicker = Clicker(scene)
    with Command(tmp_path, "init", str(scene)) as command, chromium.browser((1200, 760)) as page:
        command.until_said("click at")
        address = re.search(r"click at (http://127\.0\.0\.1:\S+)", command.err)
        assert address is not None
        page.go(address[1])
        browser = Browser(page)
        state = browser.state()
        while not state["done"]:
            if state["fits"]:
                (tmp_path / "page.png").write_bytes(page.picture())
                browser.button("accept")
            elif (pixel := clicker.answer(state)) is None:
                browser.button("hidden")
            else:
                browser.click(pixel)
            state = browser.state()
        assert "2 first poses" in command.end(), command.err
        assert command.process.returncode == 0
    for item, true in zip(BopScene(scene).first_objects(), truth_of(scene), strict=True):
        assert item.pose is not None
        distance, angle = pose_error(item.pose, true.pose)
        assert (distance < 0.01, angle < np.radians(5.0)) == (True, True), f"seed {SEED}: {distance} m, {angle} rad"
    poses = tmp_path / "poses.csv"
    run(read_deployment("tracking", [f"scene={scene}", "table=true", f"output={poses}"]), epochs=None, seed=0)
    for errors in object_errors(read_results(poses), read_truth(scene.parent.parent / "truth" / scene.name)):
        assert errors.within((5.0, 5.0)).all(), f"seed {SEED}: {errors.distance_mm}, {errors.angle_deg}"


@pytest.fixture
def page(scene: Path) -> Iterator[Page]:
    read = BopScene(scene)
    served = Page(Session(read, objects_of(read)))
    thread = Thread(target=served.until_done, daemon=True)
    thread.start()
    yield served
    served.shutdown()
    thread.join(TIMEOUT_S)


def asked(page: Page, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(HOST, page.server_port, timeout=TIMEOUT_S)
    connection.request(method, path, body if body is None or isinstance(body, bytes) else json.dumps(body), headers)
    answer = connection.getresponse()
    content = answer.status, answer.read()
    connection.close()
    return content


def test_who_does_not_know_the_token_can_neither_look_nor_click(page: Page) -> None:
    click = {"action": "click", "x": 5, "y": 5}
    assert asked(page, "GET", f"/{page.token}/state")[0] == 200
    assert asked(page, "GET", f"/{page.token}/")[1].startswith(b"<!doctype html>")
    assert asked(page, "GET", f"/{page.token}/picture.png")[1].startswith(b"\x89PNG")
    assert asked(page, "GET", f"/{page.token}/model.png?1")[1].startswith(b"\x89PNG")
    for path in ("/", "/state", f"/{page.token[:-1]}/state", f"/{page.token}x/state", "/picture.png"):
        assert asked(page, "GET", path)[0] == 404
    assert asked(page, "POST", "/do", click)[0] == 404
    assert asked(page, "POST", f"/{page.token[::-1]}/do", click)[0] == 404
    assert asked(page, "POST", f"/{page.token}/do", click, Host="elsewhere.example")[0] == 404
    assert asked(page, "POST", f"/{page.token}/do", b" " * 2000)[0] == 404
    for junk in (b"{", b"[]", b"[" * 900, b"\xff"):
        assert asked(page, "POST", f"/{page.token}/do", junk)[0] == 400
    assert json.loads(asked(page, "GET", f"/{page.token}/state")[1])["clicked"] == []
    assert json.loads(asked(page, "POST", f"/{page.token}/do", click)[1])["clicked"] == [[1, 5.0, 5.0]]


def test_what_cannot_be_clicked_is_told_in_the_notice(scene: Path) -> None:
    read = BopScene(scene)
    session = Session(read, objects_of(read))
    for x, y in ((-1, 5), (640, 5), (5, 480.0), (float("nan"), 5), ("5", 5), (None, None), (True, 5)):
        session.do({"action": "click", "x": x, "y": y})
        assert session.state()["notice"] == "That is outside of the picture."
    session.do({"action": "accept"})
    assert session.state()["notice"] == "There is no pose yet that fits."
    session.do({"action": "explode"})
    assert session.state()["notice"] == "No such thing can be done here."
    rng = np.random.default_rng(SEED)
    for _ in range(6):
        session.do({"action": "click", "x": float(rng.uniform(0, 640)), "y": float(rng.uniform(0, 480))})
    assert re.search(r"pixels beside those of the model, number \d most|No pose fits", session.state()["notice"])
    assert not session.state()["fits"]
    session.do({"action": "redo"})
    while session.state()["corner"] is not None:
        session.do({"action": "hidden"})
    assert session.state()["notice"].startswith("0 corners are clicked, and at least 4 are needed")
    session.do({"action": "hidden"})
    assert session.state()["notice"] == "There is no further corner."
    session.do({"action": "undo"})
    session.do({"action": "turn", "turn": 400.0, "tilt": 95})
    assert (session.state()["turn"], session.state()["tilt"]) == (40.0, 89.0)
    for _ in range(2):
        session.do({"action": "leave"})
    assert (session.done, session.found) == (True, [])


def test_a_folder_that_is_no_scene_is_told_in_one_line(scene: Path, tmp_path: Path) -> None:
    info = scene.parent.parent / "models" / "models_info.json"

    def refused(*arguments: str) -> str:
        done = said_here("init", *arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
        return done.stderr

    assert "nowhere: no such folder; expected a BOP scene" in refused(str(tmp_path / "nowhere"))
    assert "scene_camera.json: no such file" in refused(str(tmp_path))
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        assert "expected a free port" in refused(str(scene), "--port", str(taken.getsockname()[1]))
    (scene / FIRST_POSES).write_text("{}")
    assert "first_poses.json: is there already; --overwrite replaces it" in refused(str(scene))
    (scene / FIRST_POSES).unlink()
    info.write_text("{}")
    assert "models_info.json: no entry '1'" in refused(str(scene))
    (scene / "scene_gt.json").unlink()
    assert "models_info.json: expected an entry for the number of each model" in refused(str(scene))
    info.unlink()
    assert "models_info.json: no such file" in refused(str(scene))
    shutil.rmtree(scene / "rgb")
    assert "expected a folder of images" in refused(str(scene))


def test_first_poses_of_a_user_are_read_in_the_place_of_those_told(scene: Path) -> None:
    entry = {"obj_id": 2, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 500.0]}
    (scene / FIRST_POSES).write_text(json.dumps({"0": [entry]}))
    (item,) = BopScene(scene).first_objects()
    assert (item.id, item.obj_id, item.pose is not None) == (1, 2, True)
    assert [item.obj_id for item in BopScene(scene).first_objects(poses=False)] == [1, 2]
    assert objects_of(BopScene(scene)) == [1, 2]
    (scene / "scene_gt.json").unlink()
    assert [item.obj_id for item in BopScene(scene).first_objects(poses=False)] == [2]
    assert objects_of(BopScene(scene)) == [1, 2]


def test_ctrl_c_ends_it_and_nothing_is_written(scene: Path, tmp_path: Path) -> None:
    with Command(tmp_path, "init", str(scene)) as command:
        command.until_said("click at")
        os.kill(command.process.pid, signal.SIGINT)
        command.end()
        assert command.process.returncode == 130
    assert not (scene / FIRST_POSES).exists()
