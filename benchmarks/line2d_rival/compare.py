"""First poses: hierax's own search beside LINE-2D (Hinterstoisser et al., TPAMI 2012), on the same scenes in one run.

    make line2d
    python benchmarks/line2d_rival/compare.py SCENE… [--keep DIR]

SCENE is a folder in the BOP format with the truth beside it, as `hierax bench tracking --keep` leaves one; its plane
z = 0 carries the objects. LINE-2D, as OpenCV's contributed modules have it, is given the first picture and
flatly shaded views of each model in all poses that hierax's search tries, some places further apart; its best match is
put onto the table along its pixel's ray. From there hierax tracks, with a start as uncertain as views are apart, and
both are judged as `hierax bench tracking --start search` does: in frame 30, by objects that are seen by 0.6 or more.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from hierax.nodes.benchmarks.first_poses import Starts, bench_starts
from hierax.nodes.benchmarks.tracking import Scene
from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import FIRST_POSES, BopScene
from hierax.nodes.tracking.datasets.first_poses import write_first_poses
from hierax.nodes.tracking.imagery.proposals import places_on, resting_poses
from hierax.nodes.tracking.math.geometry import Floats, invert, project, rays, transform
from hierax.nodes.tracking.model.shapes import Shape, shape_of
from hierax.runtime.core.errors import HieraxError

PYTHON = Path(__file__).parents[2] / ".venv" / "line2d" / "bin" / "python"
MATCHER = Path(__file__).with_name("matcher.py")
PLACES = 30  # about, at which views are drawn: the camera sees an object from another side at each
MARGIN_PX = 8
LIGHT = np.array([0.35, 0.25, 0.9])
# as uncertain as the best view leaves a pose
START = ("start=given", "nodes.arm.parameters.start_m=0.015", "nodes.arm.parameters.start_rad=0.15")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both in one table; the exit code: 1 where a scene cannot be read, or the rival is not installed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="+", metavar="SCENE", help="a BOP scene, DATASET/SPLIT/000001")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for the poses; by default one that goes")
    options = parser.parse_args(arguments)
    if not PYTHON.exists():
        print(f"error: {PYTHON}: no such file; make line2d installs it", file=sys.stderr)
        return 1
    with ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        try:
            rows = compared([path.resolve() for path in options.scene], folder)
        except (DataError, HieraxError, subprocess.CalledProcessError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(f"{'':<12}{'seen':>6}{'right':>7}{'given':>7}{'wrong':>7}{'ms of search an object':>24}")
    for name, each, search_ms in rows:
        print(f"{name:<12}{each.seen:>6}{each.right:>7}{each.given:>7}{each.wrong:>7}{search_ms:>24.0f}")
    return 0


def compared(folders: Sequence[Path], out: Path) -> list[tuple[str, Starts, float]]:
    """Both ways, and how long each looks for an object; hierax's time has tracking in it."""
    scenes = [
        Scene("hierax", number, path, path.parents[1] / "truth" / path.name, True)
        for number, path in enumerate(folders)
    ]
    (ours,) = bench_starts(scenes, (), out, print)
    given, times = [], []
    for scene in scenes:
        told, ms = with_first_poses(scene, out / f"line2d-{scene.seed}")
        given.append(told)
        times.append(ms)
    (theirs,) = bench_starts(given, START, out, print)
    return [("hierax", ours, ours.object_ms), ("LINE-2D", theirs, float(np.median(times)))]


def with_first_poses(scene: Scene, out: Path) -> tuple[Scene, float]:
    """The same scene in another folder, with first poses as LINE-2D finds them; and its time for each object, ms."""
    opened = BopScene(scene.folder)
    found, took_ms = first_poses(opened, out)
    copy = out / scene.folder.parent.name / scene.folder.name
    copy.mkdir(parents=True, exist_ok=True)
    for path in scene.folder.iterdir():
        if path.name != FIRST_POSES:
            os.symlink(path, copy / path.name)
    for path in scene.folder.parents[1].iterdir():
        if path.name != scene.folder.parent.name:
            os.symlink(path, out / path.name)
    write_first_poses(copy / FIRST_POSES, opened, found)
    return replace(scene, name="line2d", folder=copy), took_ms


def first_poses(scene: BopScene, out: Path) -> tuple[list[tuple[int, Floats]], float]:
    """Objects' poses, camera_from_object, in the first picture; objects that are not found are left out."""
    out.mkdir(parents=True)
    frame = scene.frames[0]
    places = places_on(frame.camera, frame.intrinsics, scene.size, 0.0, None, PLACES)
    picture = scene.image(frame.image)
    told: dict[str, object] = {"picture": picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)}
    told["reach_px"] = np.sqrt(scene.size[0] * scene.size[1] / max(len(places), 1))
    poses: dict[int, list[tuple[Floats, Floats]]] = {}
    for item in scene.first_objects(poses=False):
        mesh, _ = scene.model(item.obj_id)
        shape = shape_of(mesh.vertices, mesh.faces)
        poses[item.obj_id] = [(place, rest) for place in places for rest in resting_poses(shape)]
        drawn = [
            view(shape, invert(frame.camera) @ place @ rest, frame.intrinsics) for place, rest in poses[item.obj_id]
        ]
        size = np.max([each.shape for each, _ in drawn], axis=0)
        told[f"views_{item.obj_id}"] = np.stack(
            [np.pad(each, ((0, size[0] - each.shape[0]), (0, size[1] - each.shape[1]))) for each, _ in drawn]
        )
        told[f"corners_{item.obj_id}"] = np.stack([corner for _, corner in drawn])
    np.savez(out / "views.npz", **told)
    subprocess.run([PYTHON, MATCHER, out / "views.npz", out / "found.npz"], check=True)
    found = np.load(out / "found.npz")
    result = []
    for obj_id, tried in poses.items():
        rows = found[f"found_{obj_id}"]
        if len(rows):
            place, rest = tried[int(rows[0, 0])]
            result.append(
                (obj_id, invert(frame.camera) @ moved(place, rows[0, 1:3], frame.camera, frame.intrinsics) @ rest)
            )
    return result, 1e3 * float(found["took_s"]) / max(len(poses), 1)


def moved(place: Floats, shift_px: Floats, camera: Floats, intrinsics: Floats) -> Floats:
    """A place (world_from_place) on the table that is seen elsewhere by so many pixels, to the right and down."""
    seen = project(transform(invert(camera), place[None, :3, 3]), intrinsics)[0] + shift_px
    direction = camera[:3, :3] @ rays(seen[None], intrinsics)[0]
    result = place.copy()
    result[:3, 3] = camera[:3, 3] - camera[2, 3] / direction[2] * direction
    return result


def view(shape: Shape, pose: Floats, intrinsics: Floats) -> tuple[Floats, Floats]:
    """A body, flatly shaded before black, and where its upper left pixel lies in the picture, by camera_from_object."""
    corners = transform(pose, shape.vertices)
    pixels = project(corners, intrinsics)
    low = np.floor(pixels.min(axis=0)) - MARGIN_PX
    width, height = (np.ceil(pixels.max(axis=0) - low).astype(int) + MARGIN_PX).tolist()
    image = np.zeros((height, width), dtype=np.uint8)
    triangles = corners[shape.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    towards = np.einsum("fk,fk->f", normals, triangles[:, 0]) < 0.0
    for face in np.argsort(-triangles.mean(axis=1)[:, 2]):
        if towards[face]:
            bright = abs(float(normals[face] @ LIGHT)) / float(np.linalg.norm(normals[face]) * np.linalg.norm(LIGHT))
            cv2.fillConvexPoly(
                image, np.rint(pixels[shape.faces[face]] - low).astype(np.int32), 60 + round(190 * bright)
            )
    return image, low


if __name__ == "__main__":
    sys.exit(main())
