"""The simulated castle in Debian's package visp-images-data, as a BOP scene; and how well it was tracked.

    python benchmarks/visp_castle.py OUT_DIR [--camera known|unknown] [--wrong SEED] [--model vrml|cao]
    hierax launch deploy/tracking.yaml --set scene=OUT_DIR/test/000001 --set output=poses.csv
    python benchmarks/visp_castle.py OUT_DIR --score poses.csv

The package is under the GPL: nothing of it is part of hierax; what is written to OUT_DIR is.
A castle and a cube beside it stand still, and are two objects; a camera moves, of which every
pose is known. The truth goes to OUT_DIR/truth/000001, which no node reads. With an unknown
camera the scene gives none, so that the objects seem to move; with `--wrong` start and camera
are said wrongly, as in generated scenes (hierax.nodes.tracking.generator.scenes).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from cad import read_cao, read_vrml

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.datasets.bop_json import pose_entry
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.scoring import object_errors, score, table
from hierax.nodes.tracking.generator.camera import reported_path
from hierax.nodes.tracking.generator.scenes import model_info, start_error, write_json
from hierax.nodes.tracking.math.geometry import Floats, invert, orthonormal
from hierax.nodes.tracking.model.files import write_ply
from hierax.nodes.tracking.model.mesh import Mesh

PACKAGE_FOLDER = Path("/usr/share/visp-images-data/ViSP-images/mbt-depth/Castle-simu")
SCENE = "000001"

CAMERA_MATRIX = (700.0, 0.0, 319.5, 0.0, 700.0, 239.5, 0.0, 0.0, 1.0)
"""The package says 320 and 240, as pictures are drawn: their middle. With pixel centres at integers that is half less,
or poses are off by half a millimetre (tried)."""

CASTLE_FROM_CUBE = np.array(
    [[-1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.12], [0.0, 1.0, 0.0, -0.15], [0.0, 0.0, 0.0, 1.0]]
)
"""Where the cube stands; the files do not say it, the pictures show it."""


def read_poses(folder: Path) -> dict[int, Floats]:
    """camera_from_castle by the number of the frame, of the files ``Camera_NNN.txt``.

    Raises:
        DataError: there are none, or one is damaged.
    """
    files = sorted(folder.glob("Camera_*.txt"))
    if not files:
        raise DataError(f"{folder}: no Camera_NNN.txt; is visp-images-data installed?")
    poses = {}
    for path in files:
        try:
            number = int(path.stem.split("_")[1])
            pose = np.array(path.read_text(encoding="ascii").split(), dtype=np.float64).reshape(4, 4)
        except (ValueError, OSError) as error:
            raise DataError(f"{path}: expected a 4 × 4 matrix") from error
        if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-3):
            raise DataError(f"{path}: expected a rigid pose")
        poses[number] = orthonormal(pose)
    return poses


def convert(images: Path, out: Path, known: bool = True, wrong: int | None = None, model: str = "vrml") -> int:
    """Write the BOP dataset and the truth; how many frames it has.

    Args:
        images: the package's folder ``Castle-simu``.
        out: the dataset's folder; its scene is ``test/000001``.
        known: whether the scene gives the camera's poses.
        wrong: a seed for a wrong start and a drifting camera; None for neither.
        model: "vrml" for the castle that was drawn, "cao" for its main faces alone.

    Raises:
        DataError: a file is missing or damaged.
    """
    castle = (
        read_vrml(images / "Models" / "chateau.wrl") if model == "vrml" else read_cao(images / "Models" / "chateau.cao")
    )
    meshes = [castle, read_cao(images / "Models" / "cube.cao")]
    seen = read_poses(images / "CameraPose")
    scene, truth = out / "test" / SCENE, out / "truth" / SCENE
    _write_images(images / "Images", scene / "gray", seen)
    _write_models(out / "models", meshes)
    objects = {str(number): _objects([pose, pose @ CASTLE_FROM_CUBE]) for number, pose in seen.items()}
    write_json(truth / "scene_gt.json", objects)
    numbers = sorted(seen)
    start = [seen[numbers[0]], seen[numbers[0]] @ CASTLE_FROM_CUBE]
    path = np.array([invert(seen[number]) for number in numbers])
    if wrong is not None:
        rng = np.random.default_rng(wrong)
        start = [pose @ start_error(rng) for pose in start]
        path = reported_path(path, rng)
    seen_by = [pose_entry(invert(camera), "cam_R_w2c", "cam_t_w2c") if known else {} for camera in path]
    cameras = {
        str(number): {"cam_K": list(CAMERA_MATRIX), "depth_scale": 1.0, **entry}
        for number, entry in zip(numbers, seen_by, strict=True)
    }
    write_json(scene / "scene_camera.json", cameras)
    write_json(scene / "scene_gt.json", {str(numbers[0]): _objects(start)})
    return len(numbers)


def print_score(poses: Path, truth: Path) -> None:
    """Print the figures of a results file.

    Raises:
        DataError: a file is missing or damaged.
    """
    found = object_errors(read_results(poses), read_truth(truth))
    names = {1: "castle", 2: "cube"}
    print(table({"both": score(found), **{names[each.obj_id]: score([each]) for each in found}}))


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="OUT_DIR", help="folder of the BOP dataset")
    parser.add_argument("--camera", choices=("known", "unknown"), default="known", help="default: known")
    parser.add_argument("--wrong", type=int, metavar="SEED", help="say start and camera wrongly")
    parser.add_argument("--model", choices=("vrml", "cao"), default="vrml", help="of the castle (default: vrml)")
    parser.add_argument("--images", type=Path, default=PACKAGE_FOLDER, metavar="DIR", help="the folder 'Castle-simu'")
    parser.add_argument("--score", type=Path, metavar="CSV", help="write nothing; score this results file")
    options = parser.parse_args()
    try:
        if options.score is not None:
            print_score(options.score, options.out / "truth" / SCENE)
        else:
            count = convert(options.images, options.out, options.camera == "known", options.wrong, options.model)
            print(f"{count} frames in {options.out / 'test' / SCENE}")
    except DataError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _write_images(source: Path, target: Path, seen: dict[int, Floats]) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for old in target.glob("*.png"):
        old.unlink()
    for number in seen:
        path = source / f"Image_{number:04d}.pgm"
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(f"{path}: missing or damaged; is visp-images-data installed?")
        cv2.imwrite(str(target / f"{number:06d}.png"), image)


def _write_models(folder: Path, meshes: list[Mesh]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, mesh in enumerate(meshes, start=1):
        write_ply(folder / f"obj_{number:06d}.ply", mesh)
    write_json(folder / "models_info.json", {str(at): model_info(mesh) for at, mesh in enumerate(meshes, start=1)})


def _objects(poses: list[Floats]) -> list[dict[str, Any]]:
    return [{**pose_entry(pose), "obj_id": number} for number, pose in enumerate(poses, start=1)]


if __name__ == "__main__":
    sys.exit(main())
