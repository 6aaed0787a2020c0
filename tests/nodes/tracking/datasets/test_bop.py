"""BOP scene folders and results files."""

from __future__ import annotations

import json
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import RESULTS_HEADER, BopScene, ResultsFile, read_results
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose
from hierax.nodes.tracking.model.files import write_ply
from hierax.nodes.tracking.model.mesh import box_mesh

TURN = exp_so3(np.array([0.1, 0.2, 0.3]))
CAMERA_MATRIX = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]


def edit(path: Path, *keys: str | int, value: Any) -> None:
    """Set an entry of a JSON file."""
    content = json.loads(path.read_text())
    at = content
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    path.write_text(json.dumps(content))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene of frames 3, 7 and 10 with two objects of one model."""
    folder = tmp_path / "test" / "000012"
    (folder / "rgb").mkdir(parents=True)
    cameras = {}
    for number in (10, 3, 7):
        image = np.full((6, 8, 3), number, dtype=np.uint8)
        image[0, 0] = (1, 2, 3)
        cv2.imwrite(str(folder / "rgb" / f"{number:06d}.png"), image)
        cameras[str(number)] = {"cam_K": CAMERA_MATRIX, "depth_scale": 1.0}
    cameras["7"]["cam_R_w2c"] = TURN.ravel().tolist()
    cameras["7"]["cam_t_w2c"] = [100.0, 200.0, 300.0]
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    truth = [
        {"obj_id": 5, "cam_R_m2c": TURN.ravel().tolist(), "cam_t_m2c": [1.0, -20.0, 500.0]},
        {"obj_id": 5, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 400.0]},
    ]
    (folder / "scene_gt.json").write_text(json.dumps({"3": truth}))
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "models_info.json").write_text(json.dumps({"5": {"diameter": 100.0}}))
    write_ply(tmp_path / "models" / "obj_000005.ply", box_mesh((0.1, 0.1, 0.1)))
    return folder


def test_a_model_may_be_in_another_format(scene: Path) -> None:
    models = scene.parent.parent / "models"
    corners, faces = BopScene(scene).model(5)[0]
    (models / "obj_000005.ply").unlink()
    with pytest.raises(DataError, match=r"obj_000005\.ply: no such file"):
        BopScene(scene).model(5)
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in 1000.0 * corners] + ["v 500 0 0"]
    lines += ["f {} {} {}".format(*(face + 1)) for face in faces]
    (models / "obj_000005.obj").write_text("\n".join(lines))
    assert np.allclose(BopScene(scene).model(5)[0].vertices, corners), "no face uses the last one"


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_a_model_in_metres_is_refused(scene: Path, suffix: str) -> None:
    models = scene.parent.parent / "models"
    corners, faces = box_mesh((0.1, 0.1, 0.1))
    if suffix == "ply":
        write_ply(models / "obj_000005.ply", box_mesh((0.1, 0.1, 0.1)), unit_m=1.0)
    else:
        (models / "obj_000005.ply").unlink()
        lines = ["v {:g} {:g} {:g}".format(*corner) for corner in corners] + [
            "f {} {} {}".format(*(f + 1)) for f in faces
        ]
        (models / "obj_000005.obj").write_text("\n".join(lines))
    with pytest.raises(
        DataError, match=rf"obj_000005\.{suffix}: unit: the model is 0\.173 mm large by it; expected at"
    ):
        BopScene(scene).model(5)


@pytest.mark.parametrize(
    ("diameter", "told"),
    [(0.1732, "0.173"), (17.0, "17"), (1732.0, r"1\.73e\+03"), pytest.param(10**400, "1e", id="huge")],
)
def test_a_model_of_another_unit_than_its_diameter_is_refused(scene: Path, diameter: float, told: str) -> None:
    edit(scene / "../../models/models_info.json", "5", "diameter", value=diameter)
    message = rf"obj_000005\.ply: the model is 173 mm large from corner to corner, its diameter in .*: 5 is {told}"
    with pytest.raises(DataError, match=message):
        BopScene(scene).model(5)


@pytest.mark.parametrize("diameter", [30, 100, 173.2, 900.0, None, "173", True, -1.0, 0, float("nan")])
def test_a_diameter_that_is_about_right_or_no_number_says_nothing(scene: Path, diameter: Any) -> None:
    edit(scene / "../../models/models_info.json", "5", "diameter", value=diameter)
    assert len(BopScene(scene).model(5)[0].vertices)


def test_frames_are_sorted_and_in_metres(scene: Path) -> None:
    read = BopScene(scene)
    assert read.scene_id == 12
    assert [frame.im_id for frame in read.frames] == [3, 7, 10]
    assert read.frames[0].intrinsics.tolist() == [500.0, 510.0, 320.0, 240.0]
    assert np.array_equal(read.frames[0].camera, np.eye(4))
    world_to_camera = np.linalg.inv(read.frames[1].camera)
    assert np.allclose(world_to_camera, make_pose(TURN, [0.1, 0.2, 0.3]))


def test_objects_of_the_first_frame(scene: Path) -> None:
    first, second = BopScene(scene).first_objects()
    assert (first.id, first.obj_id, second.id, second.obj_id) == (1, 5, 2, 5)
    assert np.allclose(first.pose, make_pose(TURN, [0.001, -0.02, 0.5]))
    assert np.ptp(BopScene(scene).model(5)[0].vertices, axis=0) == pytest.approx([0.1, 0.1, 0.1])


def test_colour_is_rgb_and_gray_is_gray(scene: Path) -> None:
    image = read_image(BopScene(scene).frames[1].image)
    assert image.shape == (6, 8, 3)
    assert image[0, 0].tolist() == [3, 2, 1]
    cv2.imwrite(str(scene / "rgb" / "gray.pgm"), np.full((6, 8), 9, dtype=np.uint8))
    assert read_image(scene / "rgb" / "gray.pgm").shape == (6, 8)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        (("scene_camera.json", "7", "cam_K"), [1, 2, 3], "frame 7: cam_K: expected 9 numbers"),
        (("scene_camera.json", "7", "cam_K"), [-1.0, *CAMERA_MATRIX[1:]], "frame 7: cam_K: expected positive"),
        (("scene_camera.json", "7", "cam_t_w2c"), [0, 0, "x"], "frame 7: cam_t_w2c: expected 3 numbers"),
        (("scene_camera.json", "7", "cam_R_w2c"), [2.0] * 9, "frame 7: cam_R_w2c: expected a rotation"),
        (("scene_camera.json", "12"), {"cam_K": CAMERA_MATRIX}, "no image for frame 12"),
        (("scene_camera.json", "first"), {}, "'first' is no frame number"),
        (("scene_gt.json", "3"), [], "frame 3: expected a list of objects"),
        (("scene_gt.json", "3", 1, "obj_id"), "5", "frame 3, object 1: obj_id"),
        (("scene_gt.json", "3", 0, "cam_t_m2c"), None, "frame 3, object 0: cam_t_m2c: expected 3 numbers"),
    ],
)
def test_damage_is_named(scene: Path, keys: tuple[str | int, ...], value: Any, message: str) -> None:
    file = scene / str(keys[0])
    edit(file, *keys[1:], value=value)
    with pytest.raises(DataError) as caught:
        BopScene(scene).first_objects()
    assert str(scene) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("scene_camera.json", None, "scene_camera.json: no such file"),
        ("scene_gt.json", None, "scene_gt.json: no such file"),
        ("scene_camera.json", "{", "scene_camera.json, line 1, column 2"),
        ("scene_gt.json", "[]", "scene_gt.json: expected a JSON object"),
        ("../../models/models_info.json", None, "models_info.json: no such file"),
        ("../../models/models_info.json", "{}", "models_info.json: no entry '5'"),
        ("../../models/obj_000005.ply", None, "obj_000005.ply: no such file"),
        ("../../models/obj_000005.ply", "solid", "obj_000005.ply: line 1: expected 'ply'"),
        ("rgb/000003.png", "no image", "000003.png: cannot be decoded"),
    ],
)
def test_missing_and_broken_files_are_named(scene: Path, name: str, content: str | None, message: str) -> None:
    file = scene / name
    file.unlink()
    if content is not None:
        file.write_text(content)
    with pytest.raises(DataError) as caught:
        use_everything(scene)
    assert message in str(caught.value)


def use_everything(scene: Path) -> None:
    read = BopScene(scene)
    read.model(read.first_objects()[0].obj_id)
    read_image(read.frames[0].image)


def test_a_missing_folder_is_named(tmp_path: Path, scene: Path) -> None:
    with pytest.raises(DataError, match="no such folder"):
        BopScene(tmp_path / "nowhere")
    for image in (scene / "rgb").iterdir():
        image.unlink()
    (scene / "rgb").rmdir()
    with pytest.raises(DataError, match="neither rgb/ nor gray/"):
        BopScene(scene)


def test_truth_beyond_the_first_frame_is_never_read(scene: Path) -> None:
    edit(scene / "scene_gt.json", "7", value="nonsense")
    assert len(BopScene(scene).first_objects()) == 2


def test_results_are_what_the_format_says(tmp_path: Path) -> None:
    pose = make_pose(TURN, [0.001, -0.02, 0.5])
    objects = [
        {"obj_id": 5, "pose": pose, "score": 0.75, "status": "tracked"},
        {"obj_id": 6, "pose": pose, "score": 0.0, "status": "lost"},
    ]
    path = tmp_path / "new" / "poses.csv"
    with ResultsFile(path, 12) as results:
        results.write(3, objects)
        assert len(path.read_text().splitlines()) == 2
        results.write(7, objects, 0.05)
    header, line, _ = path.read_text().splitlines()
    assert header == "scene_id,im_id,obj_id,score,R,t,time"
    fields = line.split(",")
    assert fields[:4] == ["12", "3", "5", "0.75"]
    assert np.array_equal([float(part) for part in fields[4].split(" ")], TURN.ravel())
    assert [float(part) for part in fields[5].split(" ")] == [1.0, -20.0, 500.0]
    assert fields[6] == "-1.0"
    back = read_results(path)
    assert [(row.im_id, row.time_s) for row in back] == [(3, -1.0), (7, 0.05)]
    assert np.allclose(back[0].pose, pose)


def seen(x: float, *numbers: int) -> list[dict[str, Any]]:
    """Objects of these numbers, all at `x`."""
    pose = make_pose(TURN, [x, 0.0, 0.5])
    return [{"obj_id": number, "pose": pose, "score": 1.0, "status": "tracked"} for number in numbers]


def rows(path: Path) -> list[tuple[int, int, float]]:
    """Of each line the frame, the object and its x."""
    return [(row.im_id, row.obj_id, round(float(row.pose[0, 3]), 6)) for row in read_results(path)]


def test_a_frame_told_again_takes_the_place_of_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    with ResultsFile(path, 12) as results:
        results.write(3, seen(0.1, 5, 6))
        results.write(4, seen(0.2, 5, 6, 7))
        results.write(4, seen(0.3, 5))
        assert rows(path) == [(3, 5, 0.1), (3, 6, 0.1), (4, 5, 0.3)]
        results.write(4, [])
        results.write(4, seen(0.4, 6, 7))
        results.write(5, seen(0.5, 5))
    assert rows(path) == [(3, 5, 0.1), (3, 6, 0.1), (4, 6, 0.4), (4, 7, 0.4), (5, 5, 0.5)]


@pytest.mark.parametrize("again", [False, True])
def test_an_earlier_frame_told_again_takes_back_those_behind_it(tmp_path: Path, again: bool) -> None:
    path = tmp_path / "poses.csv"
    results = ResultsFile(path, 12)
    for frame in range(30):
        results.write(frame, seen(0.1, 5))
    if again:
        results.close()
        results = ResultsFile(path, 12, again=True)
    results.write(27, seen(0.2, 5, 6))
    results.write(28, seen(0.3, 5))
    results.close()
    assert rows(path) == [(frame, 5, 0.1) for frame in range(27)] + [(27, 5, 0.2), (27, 6, 0.2), (28, 5, 0.3)]


def test_going_on_loses_nothing_wherever_a_line_was_cut(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    with ResultsFile(path, 12) as results:
        for frame in (3, 4):
            results.write(frame, seen(0.1 * frame, 5, 6))
    whole = path.read_bytes()
    kept = [(3, 5, 0.3), (3, 6, 0.3), (4, 5, 0.4), (4, 6, 0.4)]
    for cut in range(len(whole) + 1):
        path.write_bytes(whole[:cut])
        with ResultsFile(path, 12, again=True) as results:
            lines = max(0, whole[:cut].count(b"\n") - 1)
            assert path.read_text().splitlines()[0] == RESULTS_HEADER
            assert rows(path) == kept[:lines], f"cut at byte {cut}"
            results.write(4, seen(0.9, 7))
            results.write(5, seen(1.0, 8))
        assert rows(path) == [*kept[: min(lines, 2)], (4, 7, 0.9), (5, 8, 1.0)], f"cut at byte {cut}"


def test_going_on_where_nothing_is_begins_a_file(tmp_path: Path) -> None:
    with ResultsFile(tmp_path / "new" / "poses.csv", 12, again=True):
        assert (tmp_path / "new" / "poses.csv").read_text() == RESULTS_HEADER + "\n"


def test_a_file_is_begun_anew_where_it_is_another_runs(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text(f"{RESULTS_HEADER}\n1,2,3,4\n")
    with ResultsFile(tmp_path / "poses.csv", 12):
        assert (tmp_path / "poses.csv").read_text() == RESULTS_HEADER + "\n"


@pytest.mark.parametrize("content", ["x", "my notes\n", RESULTS_HEADER[:-1], f"{RESULTS_HEADER},more\n", "x" * 99])
def test_what_is_no_results_file_is_never_replaced(tmp_path: Path, content: str) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(content)
    with pytest.raises(DataError, match=r"notes\.txt: is no results file, and is not replaced; name another file$"):
        ResultsFile(path, 12)
    assert path.read_text() == content


@pytest.mark.parametrize("content", ["", RESULTS_HEADER, f"{RESULTS_HEADER}\n", f"{RESULTS_HEADER}\n1,2,3,4\n"])
@pytest.mark.parametrize("again", [False, True])
def test_no_link_is_followed(tmp_path: Path, content: str, again: bool) -> None:
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_text(content)
    link.symlink_to(target)
    with pytest.raises(DataError, match=r"link\.csv is a symbolic link, which is not followed; name another file$"):
        ResultsFile(link, 12, again)
    assert target.read_text() == content


@pytest.mark.parametrize(
    ("content", "line"),
    [("something else\n", 1), (f"{RESULTS_HEADER}\nx\n", 2), (f"{RESULTS_HEADER}\n1,2,3,4\n1,x,3,4\n", 3)],
)
def test_going_on_behind_something_else_is_refused(tmp_path: Path, content: str, line: int) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(content)
    with pytest.raises(DataError, match=rf"poses\.csv, line {line}: expected scene_id"):
        ResultsFile(path, 12, again=True)
    assert path.read_text() == content


class Watched:
    """A file that is looked into after every call that changes it."""

    def __init__(self, file: Any, path: Path) -> None:
        self._file = file
        self._path = path
        self.states: list[list[tuple[int, int, float]]] = []

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._file, name)

        def call(*arguments: Any) -> Any:
            given = method(*arguments)
            self.states.append(rows(self._path))
            return given

        return method if name == "close" else call


def test_the_file_is_whole_at_every_moment(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    with ResultsFile(path, 12) as results:
        watched = results._file = Watched(results._file, path)  # type: ignore[assignment]
        results.write(3, seen(0.1, 5, 6))
        results.write(4, seen(0.2, *range(200)))
        results.write(4, seen(0.3, *range(300)))
    assert {len(state) for state in watched.states} == {2, 202, 302}


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_frame_that_does_not_fit_leaves_no_half_line(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    with ResultsFile(path, 12) as results:
        results.write(3, seen(0.1, 5))
        with no_file_above(path.stat().st_size + 100), pytest.raises(DataError, match=r"poses\.csv: cannot be written"):
            results.write(4, seen(0.2, 5))
        assert rows(path) == [(3, 5, 0.1)]
        results.write(4, seen(0.2, 5))
    assert rows(path) == [(3, 5, 0.1), (4, 5, 0.2)]


def test_results_can_go_to_a_device() -> None:
    with ResultsFile("/dev/null", 12) as results:
        results.write(3, seen(0.1, 5))
    with ResultsFile("/dev/null", 12, again=True) as results:
        results.write(4, seen(0.1, 5))


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ((), "poses.csv: is empty; expected scene_id"),
        (("1,2,3,1,nan 0 0 0 1 0 0 0 1,1 2 3,-1",), "line 1: expected a rotation matrix as R"),
        (("1,2,3,1,5 0 0 0 5 0 0 0 5,1 2 3,-1",), "line 1: expected a rotation matrix as R"),
        (("1,2,3,1,1 0 0 0 1 0 0 0 -1,1 2 3,-1",), "line 1: expected a rotation matrix as R"),
        (("1,2,3,1,1 0 0 0 1 0 0 0 1,1 inf 3,-1",), "line 1: expected finite numbers"),
        (("1,2,3,nan,1 0 0 0 1 0 0 0 1,1 2 3,-1",), "line 1: expected finite numbers"),
        (
            ("1,2,3,1,1 0 0 0 1 0 0 0 1,1 2 3,-1", "2,2,3,1,1 0 0 0 1 0 0 0 1,1 2 3,-1"),
            "line 2: scene 2 in a file that begins with scene 1; expected one scene in a file",
        ),
    ],
)
def test_results_that_would_be_judged_wrongly_are_refused(tmp_path: Path, lines: tuple[str, ...], told: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("".join(f"{line}\n" for line in lines))
    with pytest.raises(DataError) as caught:
        read_results(path)
    assert told in str(caught.value)


def test_damaged_results_are_named(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("scene_id,im_id,obj_id,score,R,t,time\n1,2,3,0.5,1 0 0,1 2 3,-1\n")
    with pytest.raises(DataError, match=r"poses\.csv, line 2"):
        read_results(path)
    with pytest.raises(DataError, match="cannot be read"):
        read_results(tmp_path / "none.csv")


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_an_image_that_is_cut_off_is_named(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"000000.{ending}"
    picture = np.random.default_rng(3).integers(0, 255, (48, 64), np.uint8)
    assert cv2.imwrite(str(path), picture)
    assert read_image(path).shape == (48, 64)
    whole = path.read_bytes()
    for share in (0.3, 0.6, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match=rf"000000\.{ending}: cut off"):
            read_image(path)


def test_a_model_says_its_symmetries_or_its_mesh_does(scene: Path) -> None:
    info = scene.parent.parent / "models" / "models_info.json"

    def counts() -> tuple[int, int]:
        symmetry = BopScene(scene).model(5)[1]
        return len(symmetry["turns"]), len(symmetry["free"])

    assert counts() == (24, 0)  # a cube, of which nothing is said
    edit(info, "5", "symmetries_discrete", value=[])
    assert counts() == (1, 0)
    assert len(BopScene(scene).model(5, posed=False)[1]["turns"]) == 24  # of poses that look alike none is to be kept
    flip = [-1, 0, 0, 10, 0, -1, 0, 20, 0, 0, 1, 0, 0, 0, 0, 1]
    edit(info, "5", "symmetries_discrete", value=[flip])
    assert BopScene(scene).model(5)[1]["turns"][1] == pytest.approx(
        np.array([[-1, 0, 0, 0.01], [0, -1, 0, 0.02], [0, 0, 1, 0], [0, 0, 0, 1]])
    )
    assert len(BopScene(scene).model(5, posed=False)[1]["turns"]) == 2
    edit(info, "5", "symmetries_continuous", value=[{"axis": [0, 0, 2], "offset": [10, 0, 0]}])
    assert counts() == (2, 1)
    assert BopScene(scene).model(5)[1]["free"].tolist() == [[0.0, -0.01, 0.0, 0.0, 0.0, 1.0]]
    edit(info, "5", "symmetries_continuous", value=[{"axis": [0, 0, 1], "offset": [0] * 3}] * 2)
    assert counts() == (2, 1)
    edit(info, "5", "symmetries_continuous", value=[{"axis": axis, "offset": [0] * 3} for axis in np.eye(3).tolist()])
    assert counts() == (2, 3)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("symmetries_discrete", 3, "symmetries_discrete: expected a list of at most 128"),
        ("symmetries_discrete", [[0] * 16] * 200, "symmetries_discrete: expected a list of at most 128"),
        ("symmetries_discrete", [[1, 2]], "symmetries_discrete: expected 16 numbers"),
        ("symmetries_discrete", [[2.0] * 16], "symmetries_discrete: rotation: expected a rotation matrix"),
        ("symmetries_continuous", [3], "symmetries_continuous: axis: expected 3 numbers"),
        ("symmetries_continuous", [{"axis": [0, 0, 0], "offset": [0, 0, 0]}], "axis: expected a direction"),
        ("symmetries_continuous", [{"axis": [0, 0, 1]}], "symmetries_continuous: offset: expected 3 numbers"),
    ],
)
def test_what_is_wrong_with_a_symmetry_is_told(scene: Path, key: str, value: Any, told: str) -> None:
    info = scene.parent.parent / "models" / "models_info.json"
    edit(info, "5", key, value=value)
    with pytest.raises(DataError) as caught:
        BopScene(scene).model(5)
    assert str(caught.value).startswith(f"{info}: 5: ")
    assert told in str(caught.value)
