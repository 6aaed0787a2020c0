"""A scene folder's pictures as a folder and as a video, with the calibration and the objects in files of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from hierax.nodes.sources.calibration import Lens, write_calibration
from hierax.nodes.sources.images import read_image
from hierax.nodes.tracking.datasets.bop import BopScene
from hierax.nodes.tracking.generator.scenes import write_scene
from hierax.runtime import Elements, Node, Value

LOSSLESS = "FFV1"


def filmed(out: Path, frames: int, objects: int = 2, seed: int = 2, grey: bool = False) -> Path:
    """Write a scene whose camera poses nobody tells, and beside it ``video.avi`` (lossless), ``frames/``, the same with
    plain names, ``camera.yaml`` and ``objects.yaml``. Returns: the scene's folder."""
    folder = write_scene(out, "scattered", seed, frames, True, objects)
    told = folder / "scene_camera.json"
    cameras = {key: {"cam_K": each["cam_K"]} for key, each in json.loads(told.read_text()).items()}
    told.write_text(json.dumps(cameras))
    if grey:
        for path in (folder / "rgb").iterdir():
            cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    scene = BopScene(folder)
    film(scene, out / "video.avi", grey)
    (out / "frames").mkdir()
    for number, frame in enumerate(scene.frames):
        (out / "frames" / f"shot {number}.png").write_bytes(frame.image.read_bytes())
    lens = Lens("told", scene.size, scene.frames[0].intrinsics, np.zeros(5), False)
    write_calibration(lens, out / "camera.yaml")
    (out / "objects.yaml").write_text(yaml.safe_dump({"objects": entries_of(scene)}))
    return folder


def film(scene: BopScene, video: Path, grey: bool = False) -> None:
    """Write a scene's pictures as a lossless video."""
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*LOSSLESS), 30.0, scene.size, not grey)  # type: ignore[attr-defined]
    for frame in scene.frames:
        image = read_image(frame.image)
        writer.write(image if grey else np.ascontiguousarray(image[..., ::-1]))
    writer.release()


def entries_of(scene: BopScene) -> list[dict[str, Any]]:
    """The objects of a scene's first frame as `objects.yaml` has them, beside its folder ``models``."""
    return [
        {
            "id": item.id,
            "model": f"models/obj_{item.obj_id:06d}.ply",
            "unit": "mm",
            "pose": None if item.pose is None else item.pose.tolist(),
            "frame": "camera",
            "symmetries_discrete": [],
        }
        for item in scene.first_objects()
    ]


def settings(out: Path, camera: str | Path, *more: str) -> list[str]:
    """Of the deployment `tracking`, for a camera whose files stand in a folder."""
    return [f"camera={camera}", f"calibration={out / 'camera.yaml'}", f"objects={out / 'objects.yaml'}", *more]


class Eye(Node):
    """Believes the mean of the newest picture, and which it was; None: it sees nothing."""

    def initial_belief(self) -> Value:
        return {"frame": None, "mean": None}

    def observe(self, observations: Elements, belief: Value) -> Value:
        if not observations:
            return {"frame": None, "mean": None}
        return {"frame": observations[0]["frame"], "mean": float(observations[0]["image"].mean())}
