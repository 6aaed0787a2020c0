"""hierax beside ViSP's model-based tracker (edges, and edges with points), on the same scene and in one run.

    make rival
    python benchmarks/visp_rival/compare.py SCENE [--truth DIR] [--table] [--keep DIR]

SCENE is a folder in the BOP format, as `python -m hierax.nodes.tracking.generator.scenes` writes one.
ViSP tracks each object by itself, in grey pictures; its models are the plane faces of the
meshes. "fed" moves each pose by the reported camera's motion before a frame is tracked. ViSP's
settings are those that its own data set of a castle comes with.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene, read_results
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.evaluation.scoring import Score, object_errors, score, table
from hierax.nodes.tracking.math.geometry import Floats, invert
from hierax.nodes.tracking.model.mesh import Mesh

TRACKER = Path(__file__).parents[2] / ".build" / "visp_rival" / "tracker"
HIERAX = [sys.executable, "-m", "hierax.runtime.commands.entry"]
WAYS = {
    "ViSP edge": ("edge",),
    "ViSP edge, scan lines": ("scanline",),
    "ViSP edge + KLT": ("both",),
    "ViSP edge, fed": ("edge", "feed"),
    "ViSP edge + KLT, fed": ("both", "feed"),
}
TIMEOUT_S = 600.0
_FLAT = 1e-6


def plane_faces(mesh: Mesh) -> list[list[int]]:
    """The polygons of which a mesh consists: triangles in one plane, that touch, are one; holes are refused.

    Raises:
        DataError: a plane part is not bounded by one closed line.
    """
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    beside: dict[tuple[int, int], list[int]] = {}
    for number, face in enumerate(mesh.faces.tolist()):
        for start, end in zip(face, face[1:] + face[:1], strict=True):
            beside.setdefault((min(start, end), max(start, end)), []).append(number)
    group = list(range(len(mesh.faces)))
    for pair in beside.values():
        if len(pair) == 2 and normals[pair[0]] @ normals[pair[1]] > 1.0 - _FLAT:
            old, new = group[pair[0]], group[pair[1]]
            group = [new if each == old else each for each in group]
    return [_outline(mesh, [at for at, each in enumerate(group) if each == part]) for part in dict.fromkeys(group)]


def write_cao(path: Path, mesh: Mesh) -> None:
    """A mesh as a CAO model of faces from points.

    Raises:
        DataError: see `plane_faces`.
    """
    faces = plane_faces(mesh)
    rows = ["V1", str(len(mesh.vertices)), *(" ".join(f"{part:.9g}" for part in row) for row in mesh.vertices)]
    rows += ["0", "0", str(len(faces)), *(" ".join(map(str, [len(face), *face])) for face in faces), "0", "0"]
    path.write_text("\n".join(rows) + "\n", encoding="ascii")


def write_list(scene: BopScene, folder: Path) -> Path:
    """What the tracker reads: models, first poses, grey pictures, and the camera's reported poses."""
    fx, fy, cx, cy = scene.frames[0].intrinsics
    rows = [f"camera {fx} {fy} {cx} {cy}"]
    for item in scene.first_objects():
        model = folder / f"obj_{item.obj_id}.cao"
        write_cao(model, scene.model(item.obj_id)[0])
        rows.append(f"object {item.obj_id} {model} {_numbers(item.pose)}")
    for frame in scene.frames:
        image = read_image(frame.image)
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        path = folder / f"{frame.im_id:06d}.pgm"
        cv2.imwrite(str(path), grey)
        rows.append(f"frame {frame.im_id} {path} {_numbers(invert(frame.camera))}")
    path = folder / "list.txt"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def track(scene: Path, carried: bool, folder: Path) -> dict[str, tuple[Path, float]]:
    """Track with all; by way the results file, and the processor's time of a frame in milliseconds.

    Raises:
        DataError: a file is missing or damaged.
        SystemExit: a program failed.
    """
    listed = write_list(BopScene(scene), folder)
    results = {}
    for way, words in WAYS.items():
        poses = folder / f"{'-'.join(words)}.csv"
        # ViSP tells of each model that it loads; the time is the last line.
        said = _output([str(TRACKER), str(listed), str(poses), *words])
        results[way] = (poses, float(said.splitlines()[-1]))
    poses = folder / "hierax.csv"
    changes = [f"scene={scene}", f"table={str(carried).lower()}", f"output={poses}"]
    begun_s = _children_s()
    _output([*HIERAX, "run", "tracking", *(word for change in changes for word in ("--set", change))])
    frames = len(BopScene(scene).frames)
    results["hierax"] = (poses, 1000.0 * (_children_s() - begun_s) / frames)
    return results


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures of all on one scene.

    Returns:
        The exit code: 0, or 1 where a file is missing or damaged, or the rival is not built.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="a BOP scene, DATASET/SPLIT/000001")
    parser.add_argument("--truth", type=Path, metavar="DIR", help="by default DATASET/truth/000001")
    parser.add_argument("--table", action="store_true", help="for hierax: the plane z = 0 carries the objects")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for the poses; by default one that goes")
    options = parser.parse_args(arguments)
    if not TRACKER.is_file():
        print(f"error: {TRACKER}: no such file; make rival builds it", file=sys.stderr)
        return 1
    with ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        try:
            truth = read_truth(options.truth or options.scene.parent.parent / "truth" / options.scene.name)
            results = track(options.scene.resolve(), options.table, folder.resolve())
            scores = {way: score(object_errors(read_results(poses), truth)) for way, (poses, _) in results.items()}
        except DataError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    _print(scores, {way: spent_ms for way, (_, spent_ms) in results.items()})
    return 0


def _print(scores: Mapping[str, Score], spent_ms: Mapping[str, float]) -> None:
    print(table(scores))
    times = ", ".join(f"{way} {ms:.1f}" for way, ms in spent_ms.items())
    print(f"\nprocessor's ms a frame (hierax's: with start, end and reading): {times}")


def _outline(mesh: Mesh, triangles: Sequence[int]) -> list[int]:
    """The corners around plane triangles, in their order."""
    ahead: dict[int, list[int]] = {}
    sides = [
        (start, end)
        for number in triangles
        for start, end in zip(mesh.faces[number].tolist(), np.roll(mesh.faces[number], -1).tolist(), strict=True)
    ]
    known = set(sides)
    for start, end in sides:
        if (end, start) not in known:
            ahead.setdefault(start, []).append(end)
    first = next(iter(ahead))
    loop = [first]
    while (following := ahead[loop[-1]][0]) != first:
        if following in loop or following not in ahead:
            raise DataError(f"a plane part of a mesh of {len(mesh.faces)} triangles is not bounded by one closed line")
        loop.append(following)
    if len(loop) != len(ahead):
        raise DataError(f"a plane part of a mesh of {len(mesh.faces)} triangles has holes; ViSP cannot have it")
    return loop


def _children_s() -> float:
    """The processor's time that programs started from here have taken."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _numbers(pose: Floats) -> str:
    return " ".join(f"{part:.12g}" for part in pose.ravel())


def _output(command: Sequence[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    if done.returncode:
        raise SystemExit(f"{command[0]} failed: {done.stderr.strip()}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
