"""``hierax export``: a recording as other programs read it, and a deployment for what else starts processes."""

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.checks import made
from hierax.runtime.commands.errors import CommandError, UsageError
from hierax.runtime.commands.options import Overrides, option
from hierax.schemas.limits import LARGEST

if TYPE_CHECKING:
    from hierax.runtime.tools.services import Service, Written

_IMAGE = re.compile(r"[\[A-Za-z0-9][\]\[A-Za-z0-9._/:@-]*")
_KINDS = ("systemd", "compose", "kubernetes")


def export(
    what: Annotated[
        str, typer.Argument(metavar="RECORDING|systemd|compose|kubernetes", help="Of a run with a camera; or for what.")
    ],
    file: Annotated[str | None, typer.Argument(metavar="[FILE]", help="A deployment, for what starts it.")] = None,
    rosbag: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Of a recording: the rosbag2 to be written, a folder.")
    ] = None,
    poses: Annotated[
        str, typer.Option(metavar="NODE", help="Of a recording: the node that believes where objects are.")
    ] = "arm",
    output: Annotated[
        Path | None, option("--output", "-o", help="Of a deployment: the folder for what is written.")
    ] = None,
    overrides: Overrides = None,
    seed: Annotated[int, option("--seed", min=0, max=LARGEST)] = 0,
    epochs: Annotated[int | None, option("--epochs", min=1, max=LARGEST)] = None,
    image: Annotated[str, typer.Option(metavar="IMAGE", help="What containers are made from.")] = "hierax",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is there already.")] = False,
) -> int:
    """Write a recording of tracking as a rosbag2 for ROS 2 and Foxglove: pictures, camera, poses, tf, scores. Or write
    a deployment for systemd, Compose or Kubernetes: units or manifests that start it, and go on with its run."""
    if rosbag is not None and file is None and output is None:
        return _export_recording(Path(what), rosbag, poses, overwrite)
    if what not in _KINDS or file is None or output is None or rosbag is not None:
        kinds = ", ".join(_KINDS)
        raise UsageError(f"expected RECORDING --rosbag DIR, or one of {kinds} with FILE -o DIR, got {what!r}")
    from hierax.runtime.deployment.read import read_deployment
    from hierax.runtime.tools.services import Service, check_settings

    if not _IMAGE.fullmatch(image):
        raise UsageError(f"--image {image!r}: expected the name of an image, such as example.org/hierax:1")
    deployment = read_deployment(file, overrides or ())
    with made(deployment):  # what cannot be made is told here, not where it is launched
        pass
    check_settings(deployment, overrides or ())
    service = Service(deployment, tuple(overrides or ()), seed, epochs, image)
    for written in _writer(what)(service):
        print(_write(output, written, overwrite))
    return 0


def _export_recording(recording: Path, rosbag: Path, poses: str, overwrite: bool) -> int:
    from hierax.nodes.ros2.export import export_rosbag

    done = export_rosbag(recording, rosbag, poses, overwrite)
    for topic, count in sorted(done.counts.items()):
        print(f"{rosbag}: {count} messages on {topic}")
    if done.lacking:
        why = f"it lacks what {poses} believed in {done.lacking} epochs, as where a process has died"
        print(f"warning: {recording}: {why}: their pictures are without poses", file=sys.stderr)
    return 0


def _writer(kind: str) -> "Callable[[Service], list[Written]]":
    from hierax.runtime.tools.compose import compose
    from hierax.runtime.tools.kubernetes import manifests
    from hierax.runtime.tools.systemd import units

    return {"systemd": units, "compose": compose, "kubernetes": manifests}[kind]


def _write(folder: Path, written: "Written", overwrite: bool) -> Path:
    """Write a file; its path."""
    from hierax.runtime.host.private_files import check_encodable, errors_named, open_result

    path = folder / written.name
    if path.exists() and not overwrite:
        raise CommandError(f"{path}: it is there already; --overwrite replaces it, or name another folder")
    check_encodable(path)
    content = written.text.encode()  # before there is a file of which nothing could be written
    with errors_named(path):
        folder.mkdir(parents=True, exist_ok=True)
        with os.fdopen(open_result(path, private=written.is_secret), "wb") as file:
            file.truncate(0)
            file.write(content)
    return path
