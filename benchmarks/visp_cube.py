"""The photographs of a cube in Debian's package visp-images-data, as a BOP scene; and how well it was tracked.

    python benchmarks/visp_cube.py OUT_DIR [--every N] [--images DIR] [--cylinder]
    hierax launch deploy/tracking.yaml --set scene=OUT_DIR/test/000001 --set output=poses.csv
    python benchmarks/visp_cube.py --score poses.csv [--every N] [--against all.csv]

With --cylinder the one beside the cube is tracked, too, and the world is the table's (--set table=true). Both stand
on one sheet of paper, so the score is how far it moves beside the cube.

The package is under the GPL: nothing of it is part of hierax; what is written to OUT_DIR
is. The cube slides on a table before a still camera. So its bottom centre stays in one
plane and its up axis keeps its direction: the score is how far the poses are from that.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from cad import cylinder_polygons, mesh_of

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.generator.scenes import model_info, write_json
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, make_pose, pose_error, transform
from hierax.nodes.tracking.model.files import write_ply
from hierax.nodes.tracking.model.mesh import Mesh

PACKAGE_FOLDER = Path("/usr/share/visp-images-data/ViSP-images/mbt")
FRAMES = 218

# From a bundle adjustment over the sequence (residual 0.37 px); the calibration in the package is off.
INTRINSICS = (525.80, 525.79, 313.06, 223.59)
RADIAL = 0.104
FIRST_TRANSLATION_M = (0.045578, 0.119824, 0.498405)
FIRST_ROTATION = (2.072485, 1.158159, -0.520008)

# The corners 0 to 3 of the model are the face that lies on the table.
BOTTOM_CENTRE_M = (-0.042, 0.042, 0.0)

# The cylinder: its foot in the cube's frame as `cube_and_cylinder.cao` has it. It is taller than that file says: where
# it ends no photograph shows.
FOOT_M = (-0.17, -0.03, 0.0)
RADIUS_M, HEIGHT_M = 0.0395, 0.3


def read_cao(path: Path) -> Mesh:
    """Vertices and faces of a CAO model that consists of faces from points.

    Raises:
        DataError: the file is missing or is not laid out so.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}; is visp-images-data installed?") from error
    rows = [line.split("#")[0].split() for line in text.splitlines()]
    rows = [row for row in rows if row]
    try:
        count = int(rows[1][0])
        vertices = np.array([[float(part) for part in row] for row in rows[2 : 2 + count]]).reshape(-1, 3)
        at = 2 + count
        lines, line_faces, faces = (int(rows[at + step][0]) for step in range(3))
        if lines or line_faces:
            raise ValueError("lines")
        polygons = [[int(part) for part in row] for row in rows[at + 3 : at + 3 + faces]]
        quads = [row[1:] for row in polygons if len(row) == row[0] + 1]
        triangles = [(face[0], face[at], face[at + 1]) for face in quads for at in range(1, len(face) - 1)]
    except (IndexError, ValueError) as error:
        raise DataError(f"{path}: expected points, no lines, and faces from points") from error
    return Mesh(vertices, outward(vertices, np.array(triangles, dtype=np.int32)))


def outward(vertices: Floats, faces: Array) -> Array:
    """The triangles of a convex body, each turned to be counter-clockwise seen from outside."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normals * (corners.mean(axis=1) - vertices.mean(axis=0)), axis=1) < 0
    return np.where(inward[:, None], faces[:, ::-1], faces)


def camera_matrix() -> Floats:
    """The 3 × 3 matrix of the camera."""
    fx, fy, cx, cy = INTRINSICS
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def first_pose() -> Floats:
    """camera_from_object in the first frame."""
    return make_pose(exp_so3(np.array(FIRST_ROTATION)), np.array(FIRST_TRANSLATION_M))


def convert(images: Path, out: Path, every: int, cylinder: bool = False) -> int:
    """Write the BOP dataset; how many frames it has.

    Args:
        images: the package's folder ``mbt``.
        out: the dataset's folder; its scene is ``test/000001``.
        every: take every n-th photograph; cylinder: with the cylinder beside the cube.
    """
    meshes, poses = [read_cao(images / "cube.cao")], [first_pose()]
    if cylinder:
        meshes.append(mesh_of(images, cylinder_polygons(np.zeros(3), np.array([0.0, 0.0, HEIGHT_M]), RADIUS_M)))
        poses.append(first_pose() @ make_pose(np.eye(3), np.array(FOOT_M)))
    scene = out / "test" / "000001"
    models = out / "models"
    (scene / "gray").mkdir(parents=True, exist_ok=True)
    models.mkdir(parents=True, exist_ok=True)
    for old in (scene / "gray").glob("*.png"):
        old.unlink()
    infos = {}
    for at, mesh in enumerate(meshes, start=1):
        write_ply(models / f"obj_{at:06d}.ply", mesh)
        infos[str(at)] = model_info(mesh)
    if cylinder:
        del infos["2"]["symmetries_discrete"]  # its mesh shows it
    write_json(models / "models_info.json", infos)
    table = {"cam_R_w2c": poses[0][:3, :3].ravel().tolist(), "cam_t_w2c": (poses[0][:3, 3] * 1000.0).tolist()}
    cameras = {}
    for number in range(0, FRAMES, every):
        source = images / "cube" / f"image{number:04d}.pgm"
        image = cv2.imread(str(source), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise DataError(f"{source}: missing or damaged; is visp-images-data installed?")
        straight = cv2.undistort(image, camera_matrix(), np.array([RADIAL, 0.0, 0.0, 0.0]))
        cv2.imwrite(str(scene / "gray" / f"{number:06d}.png"), straight)
        matrix = {"cam_K": camera_matrix().ravel().tolist(), "depth_scale": 1.0}
        cameras[str(number)] = {**matrix, **table} if cylinder else matrix
    write_json(scene / "scene_camera.json", cameras)
    objects = [
        {"cam_R_m2c": pose[:3, :3].ravel().tolist(), "cam_t_m2c": (pose[:3, 3] * 1000.0).tolist(), "obj_id": at}
        for at, pose in enumerate(poses, start=1)
    ]
    write_json(scene / "scene_gt.json", {"0": objects})
    return len(cameras)


def planarity(poses: Floats) -> tuple[float, float]:
    """How far a sliding cube's poses are from sliding.

    Args:
        poses: (n, 4, 4) camera_from_object.

    Returns:
        The bottom centre's distance from its best plane (mm rms), the up axis's angle to
        its mean direction (degrees rms).
    """
    centres, normal, up = sliding_plane(poses)
    residual = float(np.sqrt(np.mean(((centres - centres.mean(axis=0)) @ normal) ** 2)))
    cosine = np.clip(poses[:, :3, 2] @ up, -1.0, 1.0)
    tilt = float(np.sqrt(np.mean(np.arccos(cosine) ** 2)))
    return residual * 1000.0, float(np.degrees(tilt))


def sliding_plane(poses: Floats) -> tuple[Floats, Floats, Floats]:
    """The bottom centres (n, 3) of poses (n, 4, 4), the normal of their best plane, and the mean up axis."""
    centres = np.array([transform(pose, np.array(BOTTOM_CENTRE_M)) for pose in poses])
    up = poses[:, :3, 2].mean(axis=0)
    return centres, np.linalg.svd(centres - centres.mean(axis=0))[2][-1], up / np.linalg.norm(up)


def straightened(poses: Floats) -> Floats:
    """Poses of a sliding cube, put onto their own plane and upright on it: what is known of the truth.

    A pose is moved along the ray through its bottom centre, as depth is what pictures tell least.
    """
    bottom = np.array(BOTTOM_CENTRE_M)
    centres, normal, up = sliding_plane(poses)
    middle = centres.mean(axis=0)
    placed = []
    for pose, centre in zip(poses, centres, strict=True):
        turn = exp_so3(rotation_between(pose[:3, 2], up))
        rotation = turn @ pose[:3, :3]
        place = centre * (middle @ normal) / (centre @ normal)
        placed.append(make_pose(rotation, place - rotation @ bottom))
    return np.array(placed)


def rotation_between(before: Floats, after: Floats) -> Floats:
    """The rotation vector (radians) that turns one unit vector to another, the short way."""
    axis = np.cross(before, after)
    size = float(np.linalg.norm(axis))
    angle = float(np.arctan2(size, before @ after))
    return axis * (angle / size) if size > 0.0 else np.zeros(3)


def share_right(poses: dict[int, Floats], against: dict[int, Floats], most_mm: float, most_deg: float) -> float:
    """Percentage of poses that are no farther than this from those of the same frames."""
    errors = [pose_error(against[frame], pose) for frame, pose in poses.items()]
    return 100.0 * float(np.mean([1e3 * off <= most_mm and np.degrees(turn) <= most_deg for off, turn in errors]))


def compare(path: Path, full: Path) -> None:
    """Print how many poses of a results file are those of another one with all frames, straightened."""
    found = {result.im_id: result.pose for result in read_results(path) if result.obj_id == 1}
    every = {result.im_id: result.pose for result in read_results(full) if result.obj_id == 1}
    if found.keys() - every.keys():
        raise DataError(f"{full}: frame {min(found.keys() - every.keys())} is missing")
    against = dict(zip(every, straightened(np.array(list(every.values()))), strict=True))
    for most in (5.0, 2.0):
        share = share_right(found, against, most, most)
        print(f"within {most:g} mm and {most:g}°  {share:.1f} % of {full.name}, straightened")


def stillness(cubes: Floats, cylinders: Floats) -> tuple[Floats, Floats]:
    """How far a cylinder's foot (mm) and its axis (degrees) are from still beside a cube, of each frame, (n,).

    Args:
        cubes, cylinders: (n, 4, 4) camera_from_object.
    """
    beside = np.linalg.inv(cubes) @ cylinders
    feet, axes = beside[:, :3, 3], beside[:, :3, 2]
    axis = np.median(axes, axis=0)
    cosine = np.clip(axes @ axis / np.linalg.norm(axis), -1.0, 1.0)
    return 1000.0 * np.linalg.norm(feet - np.median(feet, axis=0), axis=1), np.degrees(np.arccos(cosine))


def score(path: Path, frames: int) -> None:
    """Print how many frames a results file reports and how planar the motion in it is."""
    every = read_results(path)
    results = [result for result in every if result.obj_id == 1]
    cylinders = {result.im_id: result.pose for result in every if result.obj_id == 2}
    cubes = {result.im_id: result.pose for result in results if result.im_id in cylinders}
    if cubes:
        feet, turns = stillness(np.array(list(cubes.values())), np.array([cylinders[at] for at in cubes]))
        right = 100.0 * float(np.mean((feet <= 2.0) & (turns <= 1.0)))
        print(f"cylinder            {len(cubes)} frames, {right:.1f} % within 2 mm and 1° of still beside the cube")
        print(
            f"its foot, its axis  {np.median(feet):.2f} mm, {np.median(turns):.2f}° (median); "
            f"{feet.max():.2f} mm, {turns.max():.2f}° (worst)"
        )
    reported = len({result.im_id for result in results})
    print(f"frames reported     {reported} of {frames} ({100.0 * reported / frames:.1f} %)")
    if reported < 4:
        raise DataError(f"{path}: {reported} frames are too few for a plane")
    residual, tilt = planarity(np.array([result.pose for result in results]))
    print(f"plane residual      {residual:.3f} mm rms")
    print(f"tilt of the up axis {tilt:.3f} degrees rms")


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", nargs="?", type=Path, metavar="OUT_DIR", help="folder of the BOP dataset to write")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="take every N-th photograph")
    parser.add_argument("--images", type=Path, default=PACKAGE_FOLDER, metavar="DIR", help="the folder 'mbt'")
    parser.add_argument("--cylinder", action="store_true", help="with the cylinder beside the cube")
    parser.add_argument("--score", type=Path, metavar="CSV", help="score this results file")
    parser.add_argument("--against", type=Path, metavar="CSV", help="beside the results file of all photographs")
    arguments = parser.parse_args()
    if (arguments.out is None) == (arguments.score is None) or arguments.every < 1:
        parser.error("give either OUT_DIR or --score, and an N of at least 1")
    try:
        if arguments.score is not None:
            score(arguments.score, len(range(0, FRAMES, arguments.every)))
            if arguments.against is not None:
                compare(arguments.score, arguments.against)
        else:
            count = convert(arguments.images, arguments.out, arguments.every, arguments.cylinder)
            print(f"{count} frames in {arguments.out / 'test' / '000001'}")
    except DataError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
