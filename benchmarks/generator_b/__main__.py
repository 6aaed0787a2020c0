"""Generator B: scenes for judging the tracker, by another hand: ``python benchmarks/generator_b OUT --kind hidden``.

Writes what `hierax.nodes.tracking.generator.scenes` does, in the same folders, and says as wrongly where things begin
and where the camera is; but nothing that makes a picture is shared: MuJoCo lets things fall and draws them, and shapes,
layouts, paints, light and lens are its own. No constant of the tracker may be fitted to it.

Pictures are of worn bodies, edges rounded by 0.05 to 0.2 mm, in the kind "imprecise" of bodies that are off by up to
3 mm; the models are the nominal ones, and their true poses those in which they fit the bodies best. A scene that is
there already, of equal arguments and by an equal version, is kept.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from layouts import FPS, KINDS, Scene, scene
from lens import gain_of, photograph, random_lens
from stage import INTRINSICS, visible_shares

from hierax.nodes.sources.files import DataError
from hierax.nodes.tracking.generator.camera import reported_path
from hierax.nodes.tracking.generator.scenes import Told, start_error, write_json, write_said, write_truth
from hierax.nodes.tracking.math.geometry import Floats, invert

cv2.setNumThreads(1)
FRAMES = 60
VERSION = 2  # of the pictures: another one draws scenes anew


def write(out: Path, kind: str, seed: int, frames: int, exact: bool, objects: int | None) -> Path:
    """Write a scene, unless it is there; its folder."""
    told, mark = out / "test" / "000001", out / "generator.json"
    asked = {"kind": kind, "seed": seed, "frames": frames, "exact": exact, "objects": objects, "version": VERSION}
    if mark.is_file() and json.loads(mark.read_text(encoding="utf-8")) == asked:
        return told
    mark.unlink(missing_ok=True)
    shown = scene(kind, seed, frames, objects)
    rng = np.random.default_rng([seed, *kind.encode(), 67])
    camera = np.array([shown.camera(frame / FPS) for frame in range(frames)])
    poses, shares = _photographed(shown, camera, told / "rgb", rng)
    right = exact or shown.still
    start = [pose if right else pose @ start_error(rng) for pose in poses[0]]
    models = [body.model.mesh() for body in shown.bodies]
    write_said(out, models, Told(camera if right else reported_path(camera, rng), INTRINSICS, start))
    write_truth(out, camera, INTRINSICS, poses, shares)
    write_json(mark, asked)
    return told


def _photographed(
    shown: Scene, camera: Floats, folder: Path, rng: np.random.Generator
) -> tuple[list[list[Floats]], list[Floats]]:
    """Write all frames' pictures; camera_from_model and the visible share of each object in each frame."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    lens = random_lens(rng)
    gain = gain_of(shown, lens)
    poses, shares = [], []
    for frame, eye in enumerate(camera):
        picture = photograph(shown, lens, frame, gain, rng)
        cv2.imwrite(str(folder / f"{frame:06d}.png"), picture[..., ::-1])
        shown.stage.resume(shown.state(frame / FPS))
        shares.append(visible_shares(shown.stage, shown.bodies, eye))
        placed = zip(shown.stage.poses, shown.bodies, strict=True)
        poses.append([invert(eye) @ pose @ body.model_pose for pose, body in placed])
    shown.stage.close()
    return poses, shares


def main() -> int:
    """Write a scene, or name the kinds."""
    parser = argparse.ArgumentParser(
        prog="python benchmarks/generator_b", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="OUT", nargs="?", help="folder of the dataset")
    parser.add_argument("--kind", choices=tuple(KINDS), default="scattered")
    parser.add_argument("--seed", type=int, default=0, help="draws everything (default: 0)")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"how many (default: {FRAMES})")
    parser.add_argument("--objects", type=int, help="at most so many, the first")
    parser.add_argument("--exact", action="store_true", help="say the truth of start and camera")
    parser.add_argument("--kinds", action="store_true", help="name the kinds of scenes, and do nothing")
    options = parser.parse_args()
    if options.kinds:
        print("\n".join(KINDS))
        return 0
    if options.out is None or options.frames < 1 or options.seed < 0:
        parser.error("expected OUT, at least 1 frame, and a seed from 0 on")
    try:
        print(write(options.out, options.kind, options.seed, options.frames, options.exact, options.objects))
    except (DataError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
