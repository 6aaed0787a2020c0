"""Generated scenes for tracking: ``python -m hierax.nodes.tracking.generator.scenes OUT --kind hidden --seed 3``.

Writes a dataset in the BOP format and, in a folder of its own that no node reads, the truth:

    OUT/test/000001/                 the scene: rgb/, scene_camera.json (what is said of the
                                     camera), scene_gt.json (what is said of the first frame)
    OUT/models/                      PLY models
    OUT/truth/000001/                scene_camera.json, scene_gt.json, scene_gt_info.json of all
                                     frames; in the last ``visib_fract``, the visible share

Pictures are drawn by the renderer of the simulated world, of which the mental image shares
nothing. Unless `exact`, what is said of start and camera is wrong: each object's first pose by
up to 7 mm and 3°, the camera's by a drift of up to 8 mm and 1° and a jitter of 1 mm and 0.1°."""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from hierax.nodes.sources.files import DataError, writing
from hierax.nodes.sources.shots import lens_matrix
from hierax.nodes.tracking.datasets.bop_json import pose_entry
from hierax.nodes.tracking.errors import printed
from hierax.nodes.tracking.generator.camera import reported_path
from hierax.nodes.tracking.generator.kinds import INTRINSICS, KINDS, SIZE, Film, film
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_se3, invert
from hierax.nodes.tracking.model.files import BOP_UNIT_M, write_ply
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.simworld.raster import visible_shares
from hierax.nodes.tracking.simworld.scene import develop, draw

FRAMES = 150
START_M, START_DEG = 0.007, 3.0
NOISE, BLUR_PX = 2.5, 0.7
SCENE = "000001"
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class Told(NamedTuple):
    """What nodes are told of a scene."""

    camera: Floats  # (frames, 4, 4) world_from_camera
    intrinsics: Array  # fx, fy, cx, cy in pixels
    start: Sequence[Floats]  # camera_from_object of each object in the first frame


def write_scene(
    out: Path, kind: str, seed: int, frames: int = FRAMES, exact: bool = False, objects: int | None = None
) -> Path:
    """Write a scene into a dataset's folder, where it replaces what stands there of an earlier one; equal arguments
    give equal files. Returns: the scene's folder.

    Args: kind: one of `KINDS`; seed: draws everything; frames: how many, at 30 a second; exact: say the truth of start
        and camera; the kind "pushed" always does. objects: take so many of the objects at most, the first; None: all.
    Raises ValueError: there is no such kind, or `frames` or `objects` is not positive. DataError: something cannot be
        written.
    """
    shown = film(kind, seed, frames).first(objects)
    rng = np.random.default_rng([seed, *kind.encode(), 1])
    told = exact or shown.still
    camera = shown.camera if told else reported_path(shown.camera, rng)
    poses = [[invert(eye) @ pose for pose in each] for eye, each in zip(shown.camera, shown.poses, strict=True)]
    start = poses[0] if told else [pose @ start_error(rng) for pose in poses[0]]
    with writing():
        _write_images(out / "test" / SCENE / "rgb", shown, rng)
    write_truth(out, shown.camera, INTRINSICS, poses, [_shares(shown, frame) for frame in range(len(poses))])
    curved = [thing.shape.normals is not None for thing in shown.things]
    silent = [number for number, smooth in enumerate(curved, start=1) if smooth or shown.turned]
    return write_said(out, [thing.shape.mesh for thing in shown.things], Told(camera, INTRINSICS, start), silent)


def write_said(out: Path, models: Sequence[Mesh], told: Told, silent: Sequence[int] = ()) -> Path:
    """Write all of a scene but its pictures: models, and what is told of camera and start; its folder. Of the models of
    `silent` numbers nothing is said of symmetries; of the others, that they have none. Raises DataError: something
    cannot be written."""
    scene = out / "test" / SCENE
    with writing():
        _write_models(out / "models", models, silent)
        write_json(scene / "scene_camera.json", _cameras(told.camera, told.intrinsics))
        write_json(scene / "scene_gt.json", {"0": _objects(told.start)})
    return scene


def write_truth(
    out: Path, camera: Floats, intrinsics: Array, poses: Sequence[Sequence[Floats]], shares: Sequence[Floats]
) -> None:
    """Write what is true of a scene into the dataset's folder: world_from_camera of each frame and fx, fy, cx, cy in
    pixels, camera_from_object of each object in each frame, and of each in each the visible share. Raises DataError:
    something cannot be written."""
    folder = out / "truth" / SCENE
    objects = {str(frame): _objects(each) for frame, each in enumerate(poses)}
    infos = [[{"visib_fract": round(float(share), 4)} for share in each] for each in shares]
    with writing():
        write_json(folder / "scene_camera.json", _cameras(camera, intrinsics))
        write_json(folder / "scene_gt.json", objects)
        write_json(folder / "scene_gt_info.json", {str(frame): each for frame, each in enumerate(infos)})


def start_error(rng: np.random.Generator) -> Floats:
    """An error of a first pose: its translation and its rotation even within balls."""
    parts = []
    for limit in (START_M, np.radians(START_DEG)):
        direction = rng.standard_normal(3)
        parts.append(limit * np.cbrt(rng.random()) * direction / np.linalg.norm(direction))
    return exp_se3(np.concatenate(parts))


def model_info(mesh: Mesh) -> dict[str, Any]:
    """An entry of ``models_info.json``, millimetres, of a body whose first pose is to be kept among those alike."""
    corners = mesh.vertices / BOP_UNIT_M
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    spread = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    names = [f"{name}_{axis}" for name in ("min", "size") for axis in "xyz"]
    box = dict(zip(names, np.concatenate((low, size)).tolist(), strict=True))
    return {"diameter": float(spread.max()), "symmetries_discrete": [], **box}


def write_json(path: Path, content: object) -> None:
    """Write a JSON file, and its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a scene; the exit code: 0, or 1 where something cannot be written, or a dataset is there already."""
    parser = argparse.ArgumentParser(
        prog="python -m hierax.nodes.tracking.generator.scenes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the dataset")
    parser.add_argument("--kind", choices=tuple(KINDS), required=True)
    parser.add_argument("--seed", type=int, default=0, help="draws everything (default: 0)")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"how many (default: {FRAMES})")
    parser.add_argument("--exact", action="store_true", help="say the truth of start and camera")
    parser.add_argument("--overwrite", action="store_true", help="replace the scene, the models and the truth in OUT")
    options = parser.parse_args(arguments)
    if options.frames < 1 or options.seed < 0:
        parser.error("expected at least 1 frame, and a seed from 0 on")

    def written() -> Path:
        if not options.overwrite:
            _check_none(options.out)
        return write_scene(options.out, options.kind, options.seed, options.frames, options.exact)

    return printed(written)


def _check_none(out: Path) -> None:
    """See that nothing of a dataset is replaced. Raises DataError: it would be."""
    for path in (out / "test" / SCENE, out / "models", out / "truth" / SCENE):
        if os.path.lexists(path):
            told = "--overwrite replaces what a scene consists of there, or name another folder"
            raise DataError(f"{path}: is there already; {told}")


def _write_models(folder: Path, meshes: Sequence[Mesh], silent: Sequence[int]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, mesh in enumerate(meshes, start=1):
        write_ply(folder / f"obj_{number:06d}.ply", mesh)
    infos = {str(number): model_info(mesh) for number, mesh in enumerate(meshes, start=1)}
    for number in silent:
        del infos[str(number)]["symmetries_discrete"]
    write_json(folder / "models_info.json", infos)


def _write_images(folder: Path, shown: Film, rng: np.random.Generator) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    for frame, camera in enumerate(shown.camera):
        picture = draw(shown.bodies(frame), camera, INTRINSICS, SIZE, shown.lamp, shown.wood)
        image: Array = develop(picture, BLUR_PX, NOISE, rng)
        _, content = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]), _FAST_PNG)
        (folder / f"{frame:06d}.png").write_bytes(content.tobytes())


def _shares(shown: Film, frame: int) -> Floats:
    return visible_shares(shown.bodies(frame), shown.camera[frame], INTRINSICS, SIZE)[: len(shown.things)]


def _cameras(path: Floats, intrinsics: Array) -> dict[str, Any]:
    lens = lens_matrix(intrinsics).ravel().tolist()
    poses = [pose_entry(invert(camera), "cam_R_w2c", "cam_t_w2c") for camera in path]
    return {str(frame): {"cam_K": lens, **pose, "depth_scale": 1.0} for frame, pose in enumerate(poses)}


def _objects(poses: Sequence[Floats]) -> list[dict[str, Any]]:
    return [{**pose_entry(pose), "obj_id": number} for number, pose in enumerate(poses, start=1)]


if __name__ == "__main__":
    sys.exit(main())
