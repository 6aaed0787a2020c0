"""How well a run was tracked: ``python -m hierax.nodes.tracking.evaluation.report OUTPUT [--truth DIR]``.

Reads ``poses.csv`` and ``truth.csv`` of a run's output folder (see `probes`), which are written by different nodes: the
one that tracks never sees the truth. Of a scene folder the truth is another folder's ``scene_gt.json`` of all frames.
Prints each object's errors and draws them over the frames, into ``errors.png``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import write_picture
from hierax.nodes.tracking.datasets.bop import read_results
from hierax.nodes.tracking.datasets.truth import Likeness, TruePose, read_truth
from hierax.nodes.tracking.errors import printed
from hierax.nodes.tracking.evaluation.probes import POSES_FILE, TRUTH_FILE
from hierax.nodes.tracking.evaluation.scoring import ObjectErrors, object_errors
from hierax.nodes.tracking.math.geometry import Array, Floats
from hierax.nodes.tracking.model.mesh import box_mesh
from hierax.nodes.tracking.model.symmetry import found_symmetry
from hierax.runtime import Probe, Step

PLOT_FILE = "errors.png"

_COLOURS = ((200, 55, 45), (45, 95, 190), (55, 150, 70), (205, 155, 20), (120, 70, 160), (226, 120, 40))
_WIDTH, _PANEL, _LEFT, _RIGHT, _TOP, _BOTTOM = 900, 260, 64, 130, 40, 34
_INK, _RULE, _PAPER = (60, 60, 60), (222, 222, 222), 255


class ErrorPlot(Probe):
    """Draws the errors of a run into ``errors.png`` of its output folder at its end, where the truth is known: from the
    folder with the true poses of a scene folder's frames, or as a simulated world's `Truth` has written it."""

    def __init__(self, truth: str | None = None) -> None:
        self._truth = None if truth is None else Path(truth)
        self._output: Path | None = None

    def open(self, output: Path | None) -> None:
        """Remember the folder. Raises DataError: there are no true poses in the folder named."""
        self._output = output
        if self._truth is not None:
            read_truth(self._truth)

    open_again = open

    def record(self, step: Step) -> None:
        """Nothing; all is read at the end."""

    def close(self) -> None:
        """Draw. Raises DataError: the poses or the truth are damaged, or it cannot be written."""
        if self._output is not None and (errors := _errors(self._output, self._truth)) is not None:
            write_picture(self._output / PLOT_FILE, plot(errors))


def read_errors(output: Path, truth: Path | None = None) -> list[ObjectErrors]:
    """Compare the poses in a run's output folder with the truth: ``scene_gt.json`` of all frames in a folder, or
    ``truth.csv`` of the run. Raises DataError: one of the files is missing or damaged, or there is no true pose."""
    errors = _errors(output, truth)
    if errors is not None:
        return errors
    if (output / TRUTH_FILE).is_file():
        raise DataError(f"{output / TRUTH_FILE}: no poses")
    hint = "only a run of the simulated world writes the true poses, those of a scene folder are given as --truth"
    raise DataError(f"{output / TRUTH_FILE}: no such file; {hint}")


def _errors(output: Path, truth: Path | None) -> list[ObjectErrors] | None:
    """As `read_errors`; None where there is no true pose."""
    true = _simulated_truth(output) if truth is None else read_truth(truth)
    return object_errors(read_results(output / POSES_FILE), true) if true else None


def _simulated_truth(output: Path) -> dict[int, list[TruePose]]:
    """True poses by frame, as far as they are written: the world's process may not be done when the arm's is. Its
    objects are cubes, each side of which looks the same."""
    cube = box_mesh([1.0] * 3)
    likeness = Likeness(found_symmetry(cube), cube.vertices)
    true: dict[int, list[TruePose]] = {}
    rows = read_results(output / TRUTH_FILE, growing=True) if (output / TRUTH_FILE).is_file() else []
    for row in rows:
        true.setdefault(row.im_id, []).append(TruePose(row.obj_id, row.pose, 1.0, likeness))
    return true


def table(errors: Sequence[ObjectErrors]) -> str:
    """The errors as text, one line an object."""
    lines = ["object  frames  without pose    median       max    median       max"]
    for item in errors:
        known = ~np.isnan(item.distance_mm)
        figures = [
            f"{function(part[known]):7.2f} {unit}" if known.any() else f"      – {unit}"
            for part, unit in ((item.distance_mm, "mm"), (item.angle_deg, "° "))
            for function in (np.median, np.max)
        ]
        lines.append(f"{item.obj_id:6}  {len(item.frames):6}  {item.missing:12}" + "".join(figures))
    return "\n".join(lines)


def plot(errors: Sequence[ObjectErrors]) -> Array:
    """The errors over the frames, as an RGB picture: distances above, angles below."""
    picture = np.full((2 * _PANEL, _WIDTH, 3), _PAPER, np.uint8)
    _draw_panel(picture[:_PANEL], "position error, mm", errors, [item.distance_mm for item in errors])
    _draw_panel(picture[_PANEL:], "rotation error, degrees", errors, [item.angle_deg for item in errors])
    for place, item in enumerate(errors):
        x, y = _WIDTH - _RIGHT + 18, _TOP + 8 + 20 * place
        cv2.line(picture, (x, y), (x + 22, y), _colour(place), 2, cv2.LINE_AA)
        _write(picture, f"object {item.obj_id}", (x + 30, y + 4))
    return picture


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the errors and draw the plot. Returns: The exit code: 0, or 1 where a file is missing or damaged."""
    parser = argparse.ArgumentParser(prog="python -m hierax.nodes.tracking.evaluation.report", description=__doc__)
    parser.add_argument("output", type=Path, help="the run's output folder")
    parser.add_argument("--truth", type=Path, metavar="DIR", help="folder with scene_gt.json of all frames")
    options = parser.parse_args(arguments)
    picture: Path = options.output / PLOT_FILE

    def drawn() -> str:
        errors = read_errors(options.output, options.truth)
        write_picture(picture, plot(errors))
        return f"{table(errors)}\ndrawn in {picture}"

    return printed(drawn)


def _draw_panel(panel: Array, title: str, errors: Sequence[ObjectErrors], series: Sequence[Floats]) -> None:
    values = np.concatenate(series)
    highest = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
    step = _tick_step(max(highest, 1e-3) / 4)
    top = step * np.ceil(max(highest, 1e-3) / step)
    first, last = (float(function([function(item.frames) for item in errors])) for function in (np.min, np.max))
    right, bottom = _WIDTH - _RIGHT, _PANEL - _BOTTOM
    _write(panel, title, (_LEFT, _TOP - 14))
    for level in np.arange(0.0, top + step / 2, step):
        y = round(bottom - (bottom - _TOP) * level / top)
        cv2.line(panel, (_LEFT, y), (right, y), _RULE, 1)
        _write(panel, f"{level:g}", (_LEFT - 46, y + 4))
    span = max(last - first, 1.0)
    for frame in np.arange(first, last + 1e-9, max(1.0, _tick_step(span / 8))):
        x = round(_LEFT + (right - _LEFT) * (frame - first) / span)
        cv2.line(panel, (x, bottom), (x, bottom + 4), _INK, 1)
        _write(panel, f"{frame:g}", (x - 8, bottom + 18))
    _write(panel, "frame", (right + 8, bottom + 18))
    for place, (item, numbers) in enumerate(zip(errors, series, strict=True)):
        x_px = _LEFT + (right - _LEFT) * (item.frames - first) / span
        points = np.rint(16 * np.stack((x_px, bottom - (bottom - _TOP) * numbers / top), axis=1))
        known = ~np.isnan(numbers)
        for start in np.nonzero(known[1:] & known[:-1])[0]:
            line = points[start : start + 2].astype(np.int32)
            cv2.polylines(panel, [line], False, _colour(place), 2, cv2.LINE_AA, 4)


def _tick_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20, … (and their tenths) that is not below a number."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1 - 1e-9)))


def _colour(place: int) -> tuple[int, int, int]:
    return _COLOURS[place % len(_COLOURS)]


def _write(picture: Array, text: str, at: tuple[int, int]) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)


if __name__ == "__main__":
    sys.exit(main())
