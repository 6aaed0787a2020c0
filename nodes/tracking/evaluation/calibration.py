"""Whether what the arm says of its certainty is true.

Of poses that are said to be right with some probability, as large a share should be right; and errors should be as
large as the covariances say.

    python -m hierax.nodes.tracking.evaluation.calibration BELIEFS.npz... [--diagram FILE.svg]

What it reads, what the arm believed of each object in each frame, beside the truth, `hierax bench tracking --keep DIR`
leaves there."""

import argparse
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.sources.files import DataError, writing
from hierax.nodes.tracking.datasets.truth import TruePose
from hierax.nodes.tracking.errors import printed
from hierax.nodes.tracking.evaluation.scoring import LEAST_VISIBLE, RIGHT, is_astray
from hierax.nodes.tracking.math.batched import adjoints
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, log_se3, pose_error
from hierax.nodes.tracking.model.symmetry import open_to, turns_back
from hierax.nodes.tracking.schema import TRACKED
from hierax.runtime import Probe, Step
from hierax.runtime.execution.report import Json

SURE = 0.9
_BINS = 10
_SIDE, _MARGIN = 320, 40  # of the diagram, in pixels
_KEPT = ("status", "score", "probability", "pose", "covariance")


class Beliefs(Probe):
    """The arm's corrected belief of each object in each frame, as a NumPy archive that is written at the end.

    One entry for each object in each frame: ``frame``, ``obj_id``, ``status``, ``score``, ``probability``, ``pose``
    (camera_from_object, metres) and ``covariance`` (6 × 6, of a twist in the object's frame, m² and rad²). Objects
    that are lost are there, too. A frame that is told again replaces what was told of it.

    Args: file: path, relative to the folder that the run was started in."""

    def __init__(self, file: str) -> None:
        self._file = Path(file)
        self._entries: dict[tuple[int, int], dict[str, Array | str | float]] = {}

    def record(self, step: Step) -> None:
        """One frame's beliefs."""
        belief = step.sensed
        if belief["frame"] is None:
            return
        for item in belief["objects"]:
            kept = {name: item[name] for name in _KEPT if name in item}
            self._entries[belief["frame"], item["obj_id"]] = kept

    def close(self) -> None:
        """Write the file."""
        keys = sorted(self._entries)
        columns = {name: [self._entries[key][name] for key in keys] for name in next(iter(self._entries.values()), {})}
        places = np.array(keys, dtype=np.int64).reshape(-1, 2)
        _write(self._file, {"frame": places[:, 0], "obj_id": places[:, 1], **columns})


def judge(file: Path, truth: Mapping[int, Sequence[TruePose]]) -> None:
    """Add the truth to a file of `Beliefs`, to those of its entries that are of an object that the truth knows:
    ``visible`` (share, 0 to 1), ``distance_mm``, ``angle_deg`` and ``twist``, the ξ with which ``pose @ exp_se3(ξ)`` is
    the truth, or looks like it, in metres and radians: what ``covariance`` is of; and, where there is one, ``nees``,
    its square normalised by that, for each of the degrees of freedom that images tell of. Raises DataError: the file
    cannot be written."""
    true = {(frame, pose.obj_id): pose for frame, poses in truth.items() for pose in poses}
    with np.load(file) as archive:
        columns = dict(archive)
    keys = list(zip(columns["frame"].tolist(), columns["obj_id"].tolist(), strict=True))
    known = np.array([key in true for key in keys], dtype=bool)
    columns = {name: column[known] for name, column in columns.items()}
    pairs = [(pose, true[key]) for pose, key in zip(columns["pose"], (key for key in keys if key in true), strict=True)]
    turns = [turns_back(right.symmetry, given, right.pose)[0] for given, right in pairs]
    off = [invert(right.pose) @ given @ turn for (given, right), turn in zip(pairs, turns, strict=True)]
    # Of what looks the same it is told in the frame of what was given.
    twists = [adjoints(turn[None])[0] @ -log_se3(each) for turn, each in zip(turns, off, strict=True)]
    errors = np.array([pose_error(each, np.eye(4)) for each in off]).reshape(-1, 2)
    added = {
        "visible": np.array([right.visible for _, right in pairs]),
        "distance_mm": 1000.0 * errors[:, 0],
        "angle_deg": np.degrees(errors[:, 1]),
        "twist": np.array(twists).reshape(-1, 6),
    }
    if "covariance" in columns:
        every = zip(twists, columns["covariance"], pairs, strict=True)
        added["nees"] = np.array([_nees(twist, covariance, right) for twist, covariance, (_, right) in every])
    _write(file, {**columns, **added})


def _nees(twist: Floats, covariance: Floats, true: TruePose) -> float:
    """A twist's square normalised by its covariance, in the mean of the degrees of freedom that images tell of."""
    values, axes = np.linalg.eigh(open_to(true.symmetry))
    told = axes[:, values > 0.5]
    inside = told.T @ twist
    square: float = inside @ np.linalg.solve(told.T @ covariance @ told, inside)
    return square / len(inside)


def _write(path: Path, columns: Mapping[str, object]) -> None:
    arrays: dict[str, Any] = {name: np.asarray(column) for name, column in columns.items()}
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays)


class Bin(NamedTuple):
    """Poses that were said to be right with about the same probability."""

    poses: int
    said: float  # the mean probability
    right: float  # the share that is right


class Calibration(NamedTuple):
    """Of all poses that are said to be tracked, where at least a tenth of the object is seen."""

    poses: int
    bins: tuple[Bin, ...]  # by probability, those that hold something
    sure: float  # of those said to be right with at least 0.9, the share that is right
    anees: float  # their squared error, normalised by the covariance, per degree of freedom; 1 where that is true
    anees_all: float  # the same of all poses
    astray: float  # share that is off by more than 20 mm or 10°; also of objects of which less is seen, or nothing

    @property
    def error(self) -> float:
        """The expected calibration error: how far what is said is from what is, in the mean over poses."""
        return sum(each.poses * abs(each.said - each.right) for each in self.bins) / max(1, self.poses)

    def plain(self) -> dict[str, Json]:
        """All of it as plain JSON."""
        known = {
            "error": self.error,
            "sure": self.sure,
            "anees": self.anees,
            "anees_all": self.anees_all,
            "astray": self.astray,
        }
        figures: dict[str, Json] = {name: None if np.isnan(value) else value for name, value in known.items()}
        return {"poses": self.poses, **figures, "bins": [each._asdict() for each in self.bins]}

    def text(self) -> str:
        """All of it, for people."""
        rows = [f"  said {each.said:.2f}, right {each.right:.2f} ({each.poses} poses)" for each in self.bins]
        anees = f"ANEES {self.anees:.2f} (of all {self.anees_all:.2f})"
        sure = f"of those said {SURE} or more {100 * self.sure:.1f} % right, {anees}"
        first = f"expected calibration error {self.error:.3f}; {sure}; astray {100 * self.astray:.2f} %"
        return "\n".join((first, *rows))

    def diagram(self) -> str:
        """The reliability diagram, as SVG: the share that is right over the probability that was said."""

        def at(share: float) -> float:
            return _MARGIN + share * _SIDE

        whole, end = _SIDE + 2 * _MARGIN, _MARGIN + _SIDE
        marks = [
            f'<circle cx="{at(each.said):.1f}" cy="{whole - at(each.right):.1f}" fill="#1f77b4" '
            f'r="{2 + np.log10(each.poses) * 2:.1f}"><title>{each.poses} poses</title></circle>'
            for each in self.bins
        ]
        return "\n".join(
            (
                f'<svg xmlns="http://www.w3.org/2000/svg" width="{whole}" height="{whole}" font-family="sans-serif" '
                'font-size="12" text-anchor="middle">',
                f'<rect width="{whole}" height="{whole}" fill="white"/>',
                f'<path d="M{_MARGIN} {_MARGIN}V{end}H{end}" fill="none" stroke="black"/>',
                f'<path d="M{_MARGIN} {end}L{end} {_MARGIN}" stroke="#999" stroke-dasharray="4"/>',
                *marks,
                f'<text x="{whole / 2}" y="{whole - 8}">probability that is said, 0 to 1</text>',
                f'<text transform="rotate(-90)" x="{-whole / 2}" y="20">share that is right, 0 to 1</text>',
                "</svg>\n",
            )
        )


def calibration(files: Sequence[Path]) -> Calibration | None:
    """How true is what was said in files that `judge` has added the truth to; None where nothing that is seen was.
    Raises DataError: a file cannot be read, or says nothing of probabilities, or nobody has added the truth."""
    columns = [_read(file) for file in files]
    probability, right, square, astray = (np.concatenate(each) for each in zip(*columns, strict=True))
    if not len(probability):
        return None
    place = np.minimum((probability * _BINS).astype(int), _BINS - 1)
    found = [np.nonzero(place == number)[0] for number in range(_BINS)]
    bins = tuple(Bin(len(at), float(probability[at].mean()), float(right[at].mean())) for at in found if len(at))
    sure = probability >= SURE
    share, anees = (float(each[sure].mean()) if sure.any() else float("nan") for each in (right, square))
    return Calibration(len(probability), bins, share, anees, float(square.mean()), float(astray.mean()))


def is_told(file: Path) -> bool:
    """Whether beliefs say how probable they are; those of `method=paper` do not."""
    with np.load(file) as archive:
        return "probability" in archive.files


def _read(file: Path) -> tuple[Floats, Array, Floats, Array]:
    """Of a file's tracked poses of what is seen: probability, whether right, normalised squared error; and of all
    tracked ones whether astray."""
    try:
        with np.load(file) as archive:
            known = {name: archive[name] for name in archive.files}
        tracked = known["status"] == TRACKED
        probability, millimetres, degrees, squares, visible = (
            known[name][tracked] for name in ("probability", "distance_mm", "angle_deg", "nees", "visible")
        )
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise DataError(f"{file}: cannot be read: {error}; expected beliefs of the arm") from error
    except KeyError as error:
        raise DataError(f"{file}: {error.args[0]}; expected beliefs with probabilities, beside the truth") from error
    right, seen = (millimetres < RIGHT[0]) & (degrees < RIGHT[1]), visible >= LEAST_VISIBLE
    return probability[seen], right[seen], squares[seen], is_astray(millimetres, degrees)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read files, print how true they are."""
    parser = argparse.ArgumentParser(description="How true is what the arm says of its certainty.")
    parser.add_argument("files", type=Path, nargs="+", metavar="BELIEFS.npz")
    parser.add_argument("--diagram", type=Path, metavar="FILE", help="write the reliability diagram there, as SVG")
    options = parser.parse_args(arguments)

    def judged() -> str:
        found = calibration(options.files)
        if found is None:
            raise DataError("nothing was tracked in these files")
        if options.diagram is not None:
            with writing(options.diagram):
                options.diagram.write_text(found.diagram(), encoding="utf-8")
        return found.text()

    return printed(judged)


if __name__ == "__main__":
    sys.exit(main())
