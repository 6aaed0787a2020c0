"""Tracking before cameras: a lossless video beside the scene folder that it shows, and live streams amid kills.

    python benchmarks/cameras.py                       # both, some minutes
    python benchmarks/cameras.py video --frames 218    # needs Debian's visp-images-data (GPL; nothing of it is kept)
    python benchmarks/cameras.py kills --kills 20 --seed 1

video   the photographs of a cube as a BOP folder and as a video (FFV1): the states of arm and spatial node, epoch by
        epoch, and epochs a second of both; and the video at 30 Hz: no frame passed over, and how late epochs begin
kills   a stream over HTTP at 60 Hz, reopened when it stalls or breaks off; SIGKILL of each process in turn: no picture
        twice or out of order at the arm, and the recording verifies

Exit code 1 where that is not so.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.cameras import entries_of, film, filmed, settings  # noqa: E402
from support.launched import Launched, hierax  # noqa: E402
from support.streams import Stream, number_of  # noqa: E402
from visp_cube import FRAMES, PACKAGE_FOLDER, convert  # noqa: E402

from hierax.nodes.sources.calibration import Lens, write_calibration  # noqa: E402
from hierax.nodes.sources.images import read_image  # noqa: E402
from hierax.nodes.tracking.datasets.bop import BopScene  # noqa: E402
from hierax.runtime.recording.reading import Recording  # noqa: E402
from hierax.schemas.values import encode_value  # noqa: E402

NODES = ("world", "arm", "spatial")
RATE_HZ, LATENESS_MS = 30.0, 5.0
STEADY = ("restart.max_restarts=0", "restart.restart_delay=0.0", "reopen=true", "source_timeout=0.5")


def main() -> int:
    """Run the parts, print their figures."""
    parts: dict[str, Callable[[argparse.Namespace, Path], list[str]]] = {"video": video, "kills": kills}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", choices=[*parts, []], metavar="PART")
    parser.add_argument("--frames", type=int, default=FRAMES, help="of the video")
    parser.add_argument("--kills", type=int, default=20, help="of each process")
    parser.add_argument("--seed", type=int, default=1, help="of when they are killed")
    options = parser.parse_args()
    faults = []
    for part in options.part or parts:
        with tempfile.TemporaryDirectory() as folder:
            faults += parts[part](options, Path(folder))
    print("\n".join(faults) or "all as it should be")
    return 1 if faults else 0


def video(options: argparse.Namespace, out: Path) -> list[str]:
    """The photographs as a folder and as a video."""
    convert(PACKAGE_FOLDER, out, max(1, FRAMES // options.frames))
    scene = BopScene(out / "test" / "000001")
    film(scene, out / "cube.avi", grey=read_image(scene.frames[0].image).ndim == 2)
    write_calibration(Lens("", scene.size, scene.frames[0].intrinsics, np.zeros(5), False), out / "camera.yaml")
    (out / "objects.yaml").write_text(yaml.safe_dump({"objects": entries_of(scene)}))
    seen = []
    for name, told in (("folder", [f"scene={scene.folder}"]), ("video", settings(out, out / "cube.avi"))):
        path = out / f"{name}.mcap"
        words = [word for each in told for word in ("--set", each)]
        plain = hierax("launch", "tracking", *words)
        hierax("run", "tracking", *words, "--record", str(path))
        seen.append(states(path))
        rate = plain["epochs"] / plain["wall_s"]
        print(f"{name}: {plain['epochs']} epochs, {rate:.1f} epochs/s over Zenoh, {plain['nodes']['arm']['metrics']}")
    paced = hierax("launch", "tracking", *words, "--set", f"nodes.world.rate_hz={RATE_HZ:g}")
    kept = paced["timing"]["rate"]
    lateness = f"lateness p50 {kept['p50_ms']:.2f} ms, p99 {kept['p99_ms']:.2f} ms, max {kept['max_ms']:.2f} ms"
    passed_over = paced["nodes"]["world"]["metrics"].get("passed_over", 0.0)
    print(f"video at {RATE_HZ:g} Hz: {paced['epochs']} epochs, {kept['late']} begun late, {lateness}")
    if passed_over or paced["epochs"] != plain["epochs"] or kept["p99_ms"] >= LATENESS_MS:
        return [f"{passed_over:g} frames passed over, {paced['epochs']} epochs, {lateness}"]
    return [] if seen[0] == seen[1] else ["the video's states are not those of the folder"]


def states(path: Path) -> list[tuple[bytes, ...]]:
    """Of arm and spatial node, epoch by epoch, of a recording."""
    epochs = Recording.open(path).epochs()
    return [tuple(encode_value(tuple(epoch.nodes[name].state)) for name in ("arm", "spatial")) for epoch in epochs]


def kills(options: argparse.Namespace, out: Path) -> list[str]:
    """Each process in turn, so many times."""
    rng, faults = random.Random(options.seed), []
    filmed(out, 4, objects=1)
    pictures = [read_image(frame.image) for frame in BopScene(out / "test" / "000001").frames]
    path, epochs = out / "live.mcap", 12 * options.kills * len(NODES)
    words = [word for each in (*STEADY, f"output={out / 'poses.csv'}") for word in ("--set", each)]
    begun = time.monotonic()
    with Stream(pictures, rate_hz=60.0) as stream:
        told = [word for each in settings(out, stream.url) for word in ("--set", each)]
        with Launched(out, "tracking", *told, *words, "--record", str(path), "--epochs", str(epochs)) as run:
            for node in NODES * options.kills:
                run.until_epoch(run.epoch + 3)
                time.sleep(rng.random() * 0.2)
                run.kill(node)
            metrics = run.report(timeout_s=1800.0)["nodes"]["world"]["metrics"]
    shown = [_shown(epoch) for epoch in Recording.open(path).epochs()]
    numbers = [number for number in shown if number is not None]
    if numbers != sorted(set(numbers)):
        faults.append("a picture came twice, or out of order")
    replay = hierax("replay", str(path), "--verify")
    print(f"{len(NODES) * options.kills} kills in {len(shown)} epochs, {len(numbers)} of them with a picture, in order")
    print(
        f"{time.monotonic() - begun:.0f} s, seed {options.seed}; world: {metrics}; verified: {replay['digest'][:16]}…"
    )
    return faults


def _shown(epoch: object) -> int | None:
    elements = epoch.elements("obs", "world", "arm")  # type: ignore[attr-defined]
    return number_of(elements[0]["image"]) if elements else None


if __name__ == "__main__":
    sys.exit(main())
