"""How well poses agree with the truth: ``python -m hierax.nodes.tracking.evaluation.scoring POSES.csv TRUTH_DIR``.

Errors are those of camera_from_object: the distance of the origins, and the angle between the axes, of the poses that
look like the true one the nearest's. Which do, the dataset's ``models_info.json`` says, or else the models show it.
Beside them stands the maximum symmetry-aware surface distance (MSSD) of the BOP benchmark.

An object that is hidden to more than 90 % is not counted until it is back."""

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hierax.nodes.tracking.datasets.bop import Result, read_results
from hierax.nodes.tracking.datasets.truth import TruePose, read_truth
from hierax.nodes.tracking.errors import printed
from hierax.nodes.tracking.math.geometry import Array, Floats, exp_se3, invert, log_se3, pose_error, transform
from hierax.nodes.tracking.model.symmetry import alike, turns_back

LIMITS = ((2.0, 2.0), (5.0, 5.0), (10.0, 5.0))  # millimetres and degrees within which a pose is right
LEAST_VISIBLE = 0.1  # what is seen less of an object does not count

# Visible shares that are judged apart; the last one's end is part of it.
BINS = ((0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 1.0))

HIDDEN = (0.1, 0.5)
WIDE_BINS = (HIDDEN, (0.5, 0.9))
RIGHT = (5.0, 5.0)
_LAST_FRAMES = 10
_NEAR = (10.0, 5.0)
_ASTRAY = (20.0, 10.0)
_DISPLACED = (6.0, 4.0)  # an imprecise model lies no farther beside its object; what does is wrong


class ObjectErrors(NamedTuple):
    """One object through all frames."""

    obj_id: int  # the object
    frames: Array  # (n,) their numbers
    distance_mm: Floats  # distance_mm, angle_deg: (n,) errors, nan where no pose was given
    angle_deg: Floats
    visible: Floats  # (n,) the visible share
    mssd_mm: Floats | None = None  # (n,) how far the farthest point of its surface is off; None where nobody knows it

    @property
    def counted(self) -> Array:
        """(n,) bool, whether enough of it is seen."""
        return self.visible >= LEAST_VISIBLE

    @property
    def missing(self) -> int:
        """In how many frames there is no pose."""
        return int(np.isnan(self.distance_mm).sum())

    def within(self, limit: tuple[float, float]) -> Array:
        """(n,) bool, whether the pose is right by so many millimetres and degrees."""
        return (self.distance_mm <= limit[0]) & (self.angle_deg <= limit[1])


class Band(NamedTuple):
    """Frames in which so much of an object is visible."""

    low: float  # low, high: the visible share
    high: float
    frames: int  # how many frames of objects
    shares: tuple[float, ...]  # right by each of `LIMITS`; nan where there is no frame

    def plain(self) -> dict[str, Any]:
        """As plain JSON."""
        return {"from": self.low, "to": self.high, "frames": self.frames, **_named(self.shares)}


class Score(NamedTuple):
    """A run's figures; shares are 0 to 1, nan where nothing falls under them."""

    objects: int  # objects, frames: how many there are; frames of all objects together that count
    frames: int
    shares: tuple[float, ...]  # right by each of `LIMITS`
    bands: tuple[Band, ...]  # by how much is visible, as `BINS` and `WIDE_BINS` have it
    mean_mm: float  # mean_mm, worst_mm, mean_deg, worst_deg: of the poses given
    worst_mm: float
    mean_deg: float
    worst_deg: float
    mssd_mm: float  # mean of those whose models are there
    missing: float  # share without a pose
    astray: float  # share with a pose that is off by more than 20 mm or 10 degrees
    lost: int  # objects that in none of their last ten counted frames are right by 10 mm and 5°
    # of each time that an object came back, after how many frames it was right by 5 mm and 5°; None where it was not
    # before it was gone again, or at all
    again_frames: tuple[int | None, ...]

    def band(self, low: float, high: float) -> Band:
        """One of the bands."""
        return next(band for band in self.bands if (band.low, band.high) == (low, high))

    @property
    def hidden(self) -> Band:
        """Where more than half is hidden."""
        return self.band(*HIDDEN)

    def plain(self) -> dict[str, Any]:
        """As plain JSON; what there is none of is null."""
        plain = {name: _plain(value) for name, value in self._asdict().items()}
        plain["shares"] = _named(self.shares)
        plain["bands"] = [band.plain() for band in self.bands]
        return plain


def object_errors(
    results: Iterable[Result], truth: Mapping[int, Sequence[TruePose]], displaced: bool = False
) -> list[ObjectErrors]:
    """The errors of each true object, by its number, in the poses given of one scene. Where models are imprecise each
    may lie beside its object, displaced alike in all frames, by the median of what was given, if that is no more than
    6 mm and 4°."""
    given = {(result.obj_id, result.im_id): result.pose for result in results}
    true: dict[int, list[tuple[int, TruePose]]] = {}
    for frame, poses in truth.items():
        for pose in poses:
            true.setdefault(pose.obj_id, []).append((frame, pose))
    return [_errors(obj_id, rows, given, displaced) for obj_id, rows in sorted(true.items())]


def _errors(
    obj_id: int, rows: Sequence[tuple[int, TruePose]], given: Mapping[tuple[int, int], Floats], displaced: bool
) -> ObjectErrors:
    errors = np.full((3, len(rows)), np.nan)
    off = np.eye(4)
    beside = [log_se3(nearest_off(pose, given[obj_id, at])) for at, pose in rows if (obj_id, at) in given]
    if displaced and beside:
        middle = exp_se3(np.median(beside, axis=0))
        far_m, turned_rad = pose_error(middle, np.eye(4))
        if 1000.0 * far_m <= _DISPLACED[0] and np.degrees(turned_rad) <= _DISPLACED[1]:
            off = middle
    for at, (frame, pose) in enumerate(rows):
        if (obj_id, frame) not in given:
            continue
        right = pose._replace(pose=pose.pose @ off)
        errors[:2, at] = pose_error(nearest_off(right, given[obj_id, frame]), np.eye(4))
        if pose.likeness is not None:
            points = pose.likeness.points
            turns = turns_back(pose.likeness.symmetry, given[obj_id, frame], right.pose)
            ways = invert(right.pose) @ given[obj_id, frame] @ turns
            errors[2, at] = min(np.linalg.norm(transform(way, points) - points, axis=1).max() for way in ways)
    frames = np.array([frame for frame, _ in rows])
    visible = np.array([pose.visible for _, pose in rows])
    mssd = None if rows[0][1].likeness is None else errors[2] * 1000.0
    return ObjectErrors(obj_id, frames, errors[0] * 1000.0, np.degrees(errors[1]), visible, mssd)


def nearest_off(true: TruePose, given: Floats) -> Floats:
    """true_from_given, of the poses that look like the given one the nearest's."""
    return np.asarray(invert(true.pose) @ alike(true.symmetry, given[None], true.pose)[0])


def is_astray(distance_mm: Floats, angle_deg: Floats) -> Array:
    """(n,) bool, which poses are so far off that they are another's; none of those that were not given, nan."""
    return (distance_mm > _ASTRAY[0]) | (angle_deg > _ASTRAY[1])


def frames_until(there: Array, said: Array) -> list[int | None]:
    """Of each time that something begins to be there (n,) after how many frames that is said (n,); None where it is not
    said before the end of that."""
    starts = np.nonzero(there[1:] & ~there[:-1])[0] + 1
    ends = [start + int(np.append(~there[start:], True).argmax()) for start in starts]
    found = [np.nonzero(said[start:end])[0] for start, end in zip(starts, ends, strict=True)]
    return [int(frames[0]) if len(frames) else None for frames in found]


def score(all_errors: Sequence[ObjectErrors]) -> Score:
    """The figures of some objects, of one run or of several."""
    counted = [(item, item.counted) for item in all_errors]
    parts = [(item.visible[kept], item.distance_mm[kept], item.angle_deg[kept]) for item, kept in counted]
    visible, distance, angle = (_joined(part[at] for part in parts) for at in range(3))
    mssd = _joined(item.mssd_mm[item.counted] for item in all_errors if item.mssd_mm is not None)
    right = np.array([(distance <= mm) & (angle <= degrees) for mm, degrees in LIMITS])
    whole = np.ones(len(visible), bool)
    known = ~np.isnan(distance)
    astray = known & is_astray(distance, angle)
    return Score(
        objects=len(all_errors),
        frames=len(visible),
        shares=_shares(right, whole),
        bands=tuple(_band(right, visible, low, high) for low, high in (*BINS, *WIDE_BINS)),
        mean_mm=_of(np.mean, distance[known]),
        worst_mm=_of(np.max, distance[known]),
        mean_deg=_of(np.mean, angle[known]),
        worst_deg=_of(np.max, angle[known]),
        mssd_mm=_of(np.mean, mssd[~np.isnan(mssd)]),
        missing=_of(np.mean, ~known),
        astray=_of(np.mean, astray),
        lost=sum(_is_lost(item) for item in all_errors),
        again_frames=tuple(frames for item in all_errors for frames in frames_until(item.counted, item.within(RIGHT))),
    )


def table(rows: Mapping[str, Score]) -> str:
    """Scores as text, one line each."""
    width = max(len(name) for name in rows)
    lines = [
        f"{'':{width}}  right, %              5 mm/5° by the visible share             error: mean (worst)"
        "       MSSD   no    off            back after",
        f"{'':{width}}  2/2°   5/5°   10/5°   0.1–0.5  0.5–0.9  0.9–1   mm               °"
        "      mm     pose   20/10° lost  frames (never)",
    ]
    for name, each in rows.items():
        bands = [each.hidden, each.band(0.5, 0.9), each.band(0.9, 1.0)]
        lines.append(
            f"{name:{width}} "
            + "".join(f" {percent(share):>5} " for share in each.shares)
            + "".join(f" {percent(band.shares[1]):>7} " for band in bands)
            + f" {each.mean_mm:6.2f} ({each.worst_mm:6.1f})  {each.mean_deg:6.2f} ({each.worst_deg:5.1f})"
            + (f"  {each.mssd_mm:5.2f}" if each.mssd_mm >= 0.0 else "      –")
            + f"  {percent(each.missing):>5}  {percent(each.astray):>5}  {each.lost:4}  {_times(each.again_frames)}"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a run's figures, all objects together and each alone. Returns: The exit code: 0, or 1 where a file is
    missing or damaged."""
    parser = argparse.ArgumentParser(
        prog="python -m hierax.nodes.tracking.evaluation.scoring",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("poses", type=Path, metavar="POSES.csv", help="a BOP results file")
    parser.add_argument("truth", type=Path, metavar="TRUTH_DIR", help="folder with scene_gt.json of all frames")
    parser.add_argument("--displaced", action="store_true", help="models may lie beside their objects, the same always")
    parser.add_argument("--format", choices=("text", "json"), default="text", help="how the figures are printed")
    options = parser.parse_args(arguments)

    def scored() -> str:
        found = object_errors(read_results(options.poses), read_truth(options.truth), options.displaced)
        rows = {"all": score(found), **{f"object {item.obj_id}": score([item]) for item in found}}
        plain = {name: each.plain() for name, each in rows.items()}
        return json.dumps(plain, indent=2) if options.format == "json" else table(rows)

    return printed(scored)


def _band(right: Array, visible: Floats, low: float, high: float) -> Band:
    which = (visible >= low) & ((visible < high) | (high == BINS[-1][1]))
    return Band(low, high, int(which.sum()), _shares(right, which))


def _shares(right: Array, which: Array) -> tuple[float, ...]:
    return tuple(_of(np.mean, row[which]) for row in right)


def _is_lost(item: ObjectErrors) -> bool:
    last = np.nonzero(item.counted)[0][-_LAST_FRAMES:]
    return len(last) > 0 and not item.within(_NEAR)[last].any()


def _joined(parts: Iterable[Array]) -> Array:
    return np.concatenate([*parts, np.zeros(0)])


def _of(function: Any, values: Array) -> float:
    return float(function(values)) if len(values) else float("nan")


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return list(value) if isinstance(value, tuple) else value


def _named(shares: Sequence[float]) -> dict[str, Any]:
    return {f"within_{mm:g}mm_{deg:g}deg": _plain(share) for (mm, deg), share in zip(LIMITS, shares, strict=True)}


def percent(share: float) -> str:
    """A share as a table has it."""
    return "–" if np.isnan(share) else f"{100.0 * share:.1f}"


def _times(again: Sequence[int | None]) -> str:
    known = [frames for frames in again if frames is not None]
    if not again:
        return "–"
    middle = f"{np.mean(known):.1f}" if known else "–"
    return f"{middle} ({len(again) - len(known)} of {len(again)})"


if __name__ == "__main__":
    sys.exit(main())
