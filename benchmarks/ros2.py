"""Photographs of a cube through ROS 2: by rclpy, live, and as a bag.

    python benchmarks/ros2.py                     # both; some minutes; needs Debian's visp-images-data
    python benchmarks/ros2.py live --rate 10      # needs .venv/ros: make ros2
    python benchmarks/ros2.py bag --frames 50

live    a node of rclpy publishes the photographs, `hierax launch` tracks them, the node hears a pose for each; how long
        that takes from picture to pose, beside a bare node of rclpy that answers each picture at once. A photograph
        follows when the pose of the one before was heard; with --open-loop at the rate alone
bag     the photographs as a bag that `rosbags` writes, tracked: states of arm and spatial node as those of the BOP
        folder, to the bit; exported, read by `rosbags`: poses as recorded

Exit code 1 where that is not so.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from cameras import states  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from support import launched  # noqa: E402
from support.bags import camera_info, image, write_bag  # noqa: E402
from support.cameras import entries_of  # noqa: E402
from support.launched import Launched, environment, hierax  # noqa: E402
from visp_cube import FRAMES, PACKAGE_FOLDER, convert  # noqa: E402

from hierax.nodes.sources.calibration import Lens  # noqa: E402
from hierax.nodes.sources.images import read_image  # noqa: E402
from hierax.nodes.tracking.datasets.bop import BopScene, read_results  # noqa: E402
from hierax.runtime.recording.reading import Recording  # noqa: E402

PYTHON = ROOT / ".venv" / "ros" / "bin" / "python"
FPS = 25  # whose steps are whole nanoseconds
LONG_S = 3600.0


def main() -> int:
    """Run the parts, print their figures."""
    parts: dict[str, Callable[[argparse.Namespace, Path, BopScene], list[str]]] = {"live": live, "bag": bag}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", choices=[*parts, []], metavar="PART")
    parser.add_argument("--frames", type=int, default=FRAMES, help="how many photographs, about")
    parser.add_argument("--rate", type=float, default=10.0, help="pictures a second at most, live")
    parser.add_argument("--open-loop", action="store_true", help="pictures at the rate alone")
    options = parser.parse_args()
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        convert(PACKAGE_FOLDER, out, max(1, FRAMES // options.frames))
        scene = BopScene(out / "test" / "000001")
        (out / "objects.yaml").write_text(yaml.safe_dump({"objects": entries_of(scene)}))
        words = ("--set", f"scene={scene.folder}", "--set", f"fps={FPS}", "--set", f"output={out / 'folder.csv'}")
        hierax("run", "tracking", *words, "--record", str(out / "folder.mcap"))
        for part in options.part or parts:
            faults += parts[part](options, out, scene)
    print("\n".join(faults) or "all as it should be")
    return 1 if faults else 0


def live(options: argparse.Namespace, out: Path, scene: BopScene) -> list[str]:
    """By rclpy."""
    pictures, heard, recording = out / "pictures", out / "heard.json", out / "live.mcap"
    pictures.mkdir()
    for number, frame in enumerate(scene.frames):
        np.save(pictures / f"{number:06d}.npy", read_image(frame.image))
    lens = lens_of(scene)
    camera = {"width": lens.size[0], "height": lens.size[1], "k": lens.matrix.ravel().tolist(), "d": [0.0] * 5}
    (pictures / "camera.json").write_text(json.dumps(camera))
    os.environ |= {"ROS_DOMAIN_ID": str(100 + os.getpid() % 99), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    launched.HIERAX[0] = str(PYTHON)
    told = ["camera=ros:/camera/image_raw?qos=reliable", f"objects={out / 'objects.yaml'}", "publish=ros:/hierax"]
    words = [word for each in (*told, "source_timeout=60", "epoch_deadline_s=120") for word in ("--set", each)]
    script = [str(PYTHON), str(ROOT / "tests" / "support" / "rclpy_peer.py")]
    more = ["--open-loop"] * options.open_loop + ["--with-echo", "--rate", str(options.rate)]
    echo = subprocess.Popen([*script, "--echo"], env=environment())
    try:
        with Launched(out, "tracking", *words, "--record", str(recording)) as run:
            done = subprocess.run([*script, str(pictures), str(heard), *more], env=environment(), check=False)
            run.process.send_signal(signal.SIGINT)
            run.end(120.0)
    finally:
        echo.kill()
        launched.HIERAX[0] = sys.executable
    if done.returncode:
        return [f"the node of rclpy ended with {done.returncode}; the launch said {run.err}"]
    found = json.loads(heard.read_text())
    count, poses = len(scene.frames), {int(number): np.array(pose[:3]) for number, pose in found["poses"].items()}
    apart = [
        1000.0 * float(np.linalg.norm(poses[at] - truth)) for at, truth in places(out / "folder.csv") if at in poses
    ]
    print(
        f"live: {len(poses)} poses heard of {count} photographs, {len(found['tf'])} of them in tf, {options.rate:g} Hz"
    )
    print(f"live: at most {max(apart):.3f} mm from the poses of the BOP folder, median {np.median(apart):.4f} mm")
    for name, label in (("pose", "picture to pose"), ("echo", "bare rclpy echo node")):
        times = 1000.0 * np.array(found["took_s"][name])
        print(f"live: {label} p50 {np.median(times):.2f} ms, p99 {np.percentile(times, 99):.2f} ms")
    replay = hierax("replay", str(recording), "--verify")
    print(f"live: the recording verifies: {replay['digest'][:16]}…")
    return [] if len(poses) == count and len(found["tf"]) >= count else [f"{len(poses)} poses of {count} photographs"]


def bag(options: argparse.Namespace, out: Path, scene: BopScene) -> list[str]:
    """As a bag, in and out."""
    step_ns = 10**9 // FPS
    shown = [image(step_ns * at, read_image(frame.image), "mono8") for at, frame in enumerate(scene.frames)]
    info = camera_info(lens_of(scene))
    write_bag(out / "bag", {"/camera/image_rect": shown, "/camera/camera_info": [info]})
    told = (f"camera={out / 'bag'}", f"objects={out / 'objects.yaml'}", f"output={out / 'bag.csv'}")
    words = [word for each in told for word in ("--set", each)]
    hierax("run", "tracking", *words, "--record", str(out / "bag.mcap"))
    subprocess.run(
        [*launched.HIERAX, "export", str(out / "bag.mcap"), "--rosbag", str(out / "exported")],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    faults = []
    if list(states(out / "folder.mcap")) != list(states(out / "bag.mcap")):
        faults.append("the bag's states are not those of the folder")
    with AnyReader([out / "exported"]) as reader:
        topics = [each for each in reader.connections if each.topic == "/object_1/pose"]
        read = [reader.deserialize(data, each.msgtype).pose.position for each, _, data in reader.messages(topics)]
    believed = [epoch.sensed_of("arm") for epoch in Recording.open(out / "bag.mcap").epochs()]
    expected = [each[0]["objects"][0]["pose"][:3, 3].tolist() for each in believed if each is not None]
    if [[each.x, each.y, each.z] for each in read] != expected or len(read) != len(scene.frames):
        faults.append("the exported poses are not those that were believed")
    print(f"bag: {len(shown)} photographs in, {len(read)} poses out, read by rosbags")
    return faults


def lens_of(scene: BopScene) -> Lens:
    """The camera of a scene, without distortion."""
    return Lens("", scene.size, scene.frames[0].intrinsics, np.zeros(5), False)


def places(results: Path) -> list[tuple[int, np.ndarray]]:
    """Where the object was found in each frame, metres, frames counted from 0."""
    return [(at, each.pose[:3, 3]) for at, each in enumerate(read_results(results))]


if __name__ == "__main__":
    sys.exit(main())
