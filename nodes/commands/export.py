"""``hierax export``: a recording as other programs read it."""

import sys
from pathlib import Path
from typing import Annotated

import typer


def export(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="Of a run with a camera.")],
    rosbag: Annotated[Path, typer.Option(metavar="DIR", help="The rosbag2 to be written: a folder.")],
    poses: Annotated[str, typer.Option(metavar="NODE", help="The node that believes where objects are.")] = "arm",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a bag that is there already.")] = False,
) -> int:
    """Write a recording of tracking as a rosbag2 for ROS 2 and Foxglove: pictures, camera, poses, tf, scores."""
    from hierax.nodes.ros2.export import export_rosbag

    done = export_rosbag(recording, rosbag, poses, overwrite)
    for topic, count in sorted(done.counts.items()):
        print(f"{rosbag}: {count} messages on {topic}")
    if done.lacking:
        why = f"it lacks what {poses} believed in {done.lacking} epochs, as where a process has died"
        print(f"warning: {recording}: {why}: their pictures are without poses", file=sys.stderr)
    return 0
