"""``hierax calibrate``: a camera's calibration from pictures of a board."""

import os
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hierax.runtime.commands.errors import CommandError, UsageError
from hierax.runtime.commands.show import show_progress

if TYPE_CHECKING:
    from hierax.nodes.sources.boards import Board
    from hierax.nodes.sources.images import Array


_FAMILY = "4x4_50"


class Model(str, Enum):
    """How a lens distorts."""

    plumb_bob = "plumb_bob"
    rational_polynomial = "rational_polynomial"
    equidistant = "equidistant"


def calibrate(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="A folder of pictures, a video, a device's number, a stream's URL."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The calibration, as ROS's camera_info in YAML.")],
    board: Annotated[
        str, typer.Option(metavar="COLUMNSxROWS", help="Inner corners of a chessboard; squares of a ChArUco board.")
    ] = "9x6",
    square: Annotated[str, typer.Option(metavar="LENGTH", help="Side of a square: 25mm, 2.5cm, 0.025m, 1in.")] = "25mm",
    marker: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Side of a ChArUco board's markers; none: a chessboard.")
    ] = None,
    markers: Annotated[
        str | None, typer.Option(metavar="FAMILY", help=f"OpenCV's name of those markers, {_FAMILY} by default.")
    ] = None,
    model: Annotated[Model, typer.Option(help="Of the distortion; equidistant: a fisheye lens.")] = Model.plumb_bob,
    views: Annotated[int, typer.Option(min=5, max=60, help="So many different views are enough.")] = 40,
    topic: Annotated[str | None, typer.Option(metavar="TOPIC", help="Of a bag that has pictures on several.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a calibration that is there.")] = False,
) -> int:
    """Calibrate a camera: show it a chessboard or a ChArUco board, tilted, near and far, all over the picture."""
    from hierax.nodes.sources import boards
    from hierax.nodes.sources.calibration import write_calibration
    from hierax.nodes.sources.images import write_picture

    coverage = _checked_output(output, overwrite)
    shown = _board(board, square, marker, markers)

    def progress(pictures: int, found: int) -> None:
        bar = "█" * (20 * found // views)
        show_progress(f"\r[{bar:░<20}] {found} of {views} views, in {pictures} pictures ", end="")

    found, size = boards.find_views(source, shown, _pictures(source, topic), views, progress)
    show_progress("")
    told = boards.calibrate(source, found, size, model.value)
    write_calibration(told.lens, output)
    write_picture(coverage, told.picture())
    fx, fy, cx, cy = told.lens.intrinsics
    left_out = f", {told.left_out} left out" if told.left_out else ""
    print(f"{output}: {size[0]}×{size[1]}, fx {fx:.2f}, fy {fy:.2f}, cx {cx:.2f}, cy {cy:.2f} px, {model.value}")
    print(f"rms {told.rms_px:.3f} px in {len(told.views)} views{left_out}")
    print(f"{coverage}: corners in {told.covered:.0%} of the picture")
    return 0


def _checked_output(output: Path, overwrite: bool) -> Path:
    """The path of the picture that goes with a calibration. Raises, before anybody shows a board in vain, UsageError
    where the output names no file, and CommandError where it, or the picture, cannot be written or may not be
    replaced."""
    if not output.name or output.name == "..":
        raise UsageError(f"--output {str(output)!r}: expected the name of a file, such as camera.yaml")
    if output.suffix.lower() == ".xml":
        raise UsageError(f"--output {output}: expected a name such as camera.yaml, as calibrations are written in YAML")
    coverage = output.with_name(f"{output.stem}-coverage.png")
    for path in (output, coverage):
        if path.is_dir():
            raise CommandError(f"{path}: is a folder; expected the name of a file, such as camera.yaml")
        if path.exists() and not overwrite:
            raise CommandError(f"{path}: is there already; --overwrite replaces it")
    if not os.access(output.parent, os.W_OK | os.X_OK) or not output.parent.is_dir():
        raise CommandError(f"{output}: cannot be written: {output.parent} is no folder that you may write to")
    if output.exists():
        _check_replaced(output)
    return coverage


def _check_replaced(output: Path) -> None:
    from hierax.nodes.sources.calibration import check_kind
    from hierax.nodes.sources.files import DataError

    try:
        check_kind(output)
    except DataError as error:
        raise CommandError(f"{error}: --overwrite replaces calibrations alone; give another name") from error


def _pictures(source: str, topic: str | None) -> "Iterator[Array]":
    """All frames of a source, until it ends."""
    from hierax.nodes.sources.camera import CameraWorld
    from hierax.nodes.sources.files import DataError
    from hierax.nodes.sources.live import REOPENS

    world = CameraWorld(source, topic=topic, straighten=False)
    try:
        belief = world.initial_belief()
        while not belief["ended"]:
            if belief["image"] is not None:
                yield belief["image"]
            belief = world.predict((), (), belief)
    except DataError as error:
        raise DataError(str(error).removesuffix(REOPENS)) from error  # here is no such option


def _board(board: str, square: str, marker: str | None, markers: str | None) -> "Board":
    """The board that options tell. Raises UsageError: one is none."""
    import cv2

    from hierax.nodes.sources.boards import FAMILIES, Board

    numbers = re.fullmatch(r"(\d{1,3})x(\d{1,3})", board)
    columns, rows = map(int, numbers.groups()) if numbers else (0, 0)
    if min(columns, rows) < 3:
        raise UsageError(f"--board {board}: expected COLUMNSxROWS, such as 9x6, at least 3 of each")
    side_m = _length("--square", square)
    if marker is None:
        if markers is not None:
            raise UsageError(f"--markers {markers}: means something only with --marker, their side")
        return Board(columns, rows, side_m)
    marker_m = _length("--marker", marker)
    if marker_m >= side_m:
        raise UsageError(f"--marker {marker}: expected less than the square's side, {square}")
    family = FAMILIES.get((markers or _FAMILY).lower())
    if family is None:
        raise UsageError(f"--markers {markers}: expected one of {', '.join(FAMILIES)}")
    return Board(columns, rows, side_m, marker_m, cv2.aruco.getPredefinedDictionary(family))


def _length(option: str, text: str) -> float:
    from hierax.nodes.sources.files import UNITS_M

    told = re.fullmatch(rf"(\d+(?:\.\d*)?)({'|'.join(UNITS_M)})", text)
    length = float(told[1]) * UNITS_M[told[2]] if told else 0.0
    if not 0.0001 <= length <= 100.0:
        raise UsageError(f"{option} {text}: expected a length with its unit, such as 25mm")
    return length
