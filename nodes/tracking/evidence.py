"""Why the arm believes what it does of its objects: what speaks for their poses, and for others, in nats.

All of it follows from a belief and its image. It is computed again for who looks, and costs the arm nothing."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking.estimation.alignment import Aligned, Start, align
from hierax.nodes.tracking.estimation.bending import memory_of
from hierax.nodes.tracking.estimation.certainty import present
from hierax.nodes.tracking.estimation.joint_alignment import Task, prior_of, task_of
from hierax.nodes.tracking.estimation.likelihood import Shares, expected, explains, shares
from hierax.nodes.tracking.estimation.palette import dyed, palette_of
from hierax.nodes.tracking.estimation.profiles import Image, smoothed
from hierax.nodes.tracking.estimation.stages import Search, moves_of
from hierax.nodes.tracking.estimation.tracked import dashes
from hierax.nodes.tracking.math.batched import inverse, invert_many, log_many
from hierax.nodes.tracking.math.geometry import Array, Floats, invert, pose_error
from hierax.nodes.tracking.model.controls import gathered
from hierax.nodes.tracking.schema import LOST, TRACKED, Alternative, ArmBelief, TrackedObject
from hierax.nodes.tracking.search.multistart import FINE, squared

KINDS = ("outline", "crease", "smooth")  # of edges, by number
_FIXED = 1e12 * np.eye(6)  # information on a pose that is not to be moved
_MOST_EDGES = 16  # so many of an object are told one by one
_DASH_PX = 1.5  # half of what is drawn at a control point
_HEAD = ("edge", "is", "at, px", "expected", "seen", "off, px", "off, mm", "nats")
_OTHERS = ("instead", "nats", "away, mm", "turned, °")
_PLACES = ("from the camera: right, down, ahead, mm", "nats")


class Edge(NamedTuple):
    """What one edge of an object says of its pose."""

    number: int
    kind: str  # of `KINDS`
    at: Floats  # (2,) its middle in the image, pixels
    expected: float  # how many of its control points should be seen
    seen: float  # how many of these are
    off_px: float  # how far they are beside where the pose puts them in the mean, to the object's side; nan: none is
    off_mm: float  # the same in the object
    nats: float
    dashes: Floats  # (k, 2, 2) along it at each of its control points, pixels


class Other(NamedTuple):
    """Another pose that an object may have."""

    name: str
    pose: Floats  # camera_from_object
    edges: Floats  # (n, 2, 3) m, object's frame: as `TrackedObject` has it
    nats: float
    away_mm: float  # from the pose that is believed
    turned_deg: float


class Evidence(NamedTuple):
    """What speaks for the pose of an object, and what for others."""

    item: TrackedObject
    others: tuple[Other, ...]  # best first
    prior: float | None  # how likely the pose was before the image; None where the prediction is not known
    nats: float  # by how much the pose explains the image better than clutter does: the sum of the next five
    found: float  # of control points that speak for it
    missing: float  # of those that speak against it: where they should be seen nothing is near
    looks: float  # of peaks that look strange
    wholes: float  # of edges that are off as a whole
    colours: float  # of its faces, that they have its colours
    edges: tuple[Edge, ...]  # those that speak for it most first

    def text(self) -> str:
        """As Markdown that can be read as it stands."""
        item = self.item
        exists = float(present(np.array(item["nats"]))) if item["status"] == TRACKED else 0.0
        parts = [("found", self.found), ("not found", self.missing), ("strange looks", self.looks)]
        parts += [("edges off as a whole", self.wholes), ("colours", self.colours)]
        prior = "" if self.prior is None else f"; how far it is from the prediction {self.prior:+.1f}"
        head = (
            f"### object {item['id']}: {item['status']}\n\n"
            f"P {item['probability']:.2f} that it is right by 5 mm and 5°, {exists:.2f} that it is there "
            f"({item['nats']:+.1f} nats when it was matched, score {item['score']:.2f}).\n"
            f"At the pose that is believed {self.nats:+.1f} nats: "
            + ", ".join(f"{name} {nats:+.1f}" for name, nats in parts)
            + prior
        )
        rows = [_row(edge) for edge in self.edges]
        if len(rows) > _MOST_EDGES:
            half = _MOST_EDGES // 2
            between = sum(edge.nats for edge in self.edges[half:-half])
            left = (f"{len(rows) - _MOST_EDGES} more", *[""] * 6, f"{between:+.1f}")
            rows = [*rows[:half], left, *rows[-half:]]
        others = [
            (each.name, f"{each.nats:+.1f}", f"{each.away_mm:.1f}", f"{each.turned_deg:.1f}") for each in self.others
        ]
        return "\n\n".join([head, *(_table(*each) for each in ((_HEAD, rows), (_OTHERS, others)) if each[1])])


class Sought(NamedTuple):
    """Where an object may be of which nobody knows where it is."""

    item: TrackedObject
    others: tuple[Other, ...]  # best first

    def text(self) -> str:
        """As Markdown that can be read as it stands."""
        item, needed = self.item, const.CONFIRMED * const.CLEAR_NATS
        lead = f"It leads by {item['lead']:.1f} nats" if item["lead"] else "None leads"
        head = (
            f"### object {item['id']}: {item['status']}\n\n"
            f"It was looked for everywhere {item['failed_searches']} times, and may be in {len(self.others)} places. "
            f"{lead}, added up over images in a row; with {needed:.0f} it is found."
        )
        rows = []
        for each in self.others:
            x, y, z = 1000.0 * each.pose[:3, 3]
            rows.append((f"{x:.0f}, {y:.0f}, {z:.0f}", f"{each.nats:+.1f}"))
        return "\n\n".join([head, *([_table(_PLACES, rows)] if rows else [])])


def sought(image: Array, after: ArmBelief, kept: ArmBelief) -> list[Sought]:
    """Where objects may be that are lost: the poses at which the arm is asked to look for them in the next image, and
    by how much each explains this one better than clutter does; arguments as for `evidence`."""
    intrinsics = after["intrinsics"]
    if intrinsics is None or all(item["status"] != LOST for item in after["objects"]):
        return []
    light = smoothed(image)
    palette = palette_of(light, [item["slots"] for item in after["objects"]])
    asked = {item["id"]: item["others"] for item in kept["objects"]}
    found = []
    for at, item in enumerate(after["objects"]):
        if item["status"] != LOST:
            continue
        others = [other for other in asked.get(item["id"], ()) if len(other["controls"]["points"])]
        aligned = _at_others(light, item, others, _FIXED, np.asarray(intrinsics), FINE) if others else None
        nats = [] if aligned is None else (explains(aligned) + dyed(aligned, palette, [at] * len(others))).tolist()
        each = [
            _other("imagined", item, other["pose"], dashes(other["controls"]), said)
            for other, said in zip(others, nats, strict=False)
        ]
        found.append(Sought(item, tuple(sorted(each, key=lambda other: -other.nats))))
    return found


def _at_others(
    light: Image,
    item: TrackedObject,
    others: Sequence[Alternative],
    information: Floats,
    intrinsics: Array,
    search: Search,
) -> Aligned | None:
    """What an image shows of an object at other poses, each known as well as (6, 6) information says."""
    controls = gathered([other["controls"] for other in others])
    memory = memory_of([item["slots"]] * len(others), controls, light.shape[2])
    start = Start(np.stack([other["pose"] for other in others]), np.tile(information, (len(others), 1, 1)))
    return align(light, controls, start, intrinsics, memory, search)


def evidence(
    image: Array, after: ArmBelief, before: ArmBelief | None, kept: ArmBelief, motion: Floats
) -> list[Evidence]:
    """What speaks for the poses of all objects of which something is expected to be seen.

    Args: image: uint8, as it was observed; after: the belief after it; before: the one that the epoch began in, or
        None; kept: the one after the context came, with the poses that the arm is asked to compare in the next image;
        motion: (6, 6) covariance of how far an object may leave its prediction within a frame, when it is pushed.
    """
    intrinsics, camera = after["intrinsics"], after["camera"]
    objects = [item for item in after["objects"] if len(item["controls"]["points"])]
    if not objects or intrinsics is None or camera is None:
        return []
    known, moved = {}, np.eye(4)
    if before is not None and before["camera"] is not None:
        known = {item["id"]: item for item in before["objects"]}
        moved = invert(camera) @ before["camera"]
    told = [_as_known(item, known.get(item["id"])) for item in objects]
    task = task_of(smoothed(image), told, prior_of(told, motion, None), intrinsics)
    predicted = np.stack([moved @ known.get(item["id"], item)["pose"] for item in objects])
    believed, expected_there = _aligned(task, task.start.poses), _aligned(task, predicted)
    if believed is None or expected_there is None:
        return []
    colours = dyed(believed, task.palette, range(len(objects)))
    parts, nats = shares(believed), explains(believed) + colours
    before_nats = explains(expected_there) + dyed(expected_there, task.palette, range(len(objects)))
    spread = task.prior.spread()
    unlikely = 0.5 * squared(log_many(invert_many(predicted) @ task.start.poses), inverse(spread))
    asked = {item["id"]: item["others"] for item in kept["objects"]}
    found = []
    for at, item in enumerate(objects):
        others = _others(task, item, at, asked.get(item["id"], ()))
        if item["id"] in known:
            others.append(_other("as predicted", item, predicted[at], item["edges"], float(before_nats[at])))
        prior = -float(unlikely[at]) if item["id"] in known else None
        best = tuple(sorted(others, key=lambda each: -each.nats))
        said, edges = _said(believed, parts, at), _edges(believed, parts, at, intrinsics)
        found.append(Evidence(item, best, prior, float(nats[at]), *said, float(colours[at]), edges))
    return found


def _as_known(item: TrackedObject, before: TrackedObject | None) -> TrackedObject:
    """An object where it is believed to be, with what was known of it when the image came."""
    if before is None:
        return item
    kept = {"motion_scale": before["motion_scale"], "covariance": before["covariance"]}
    if before["slots"]["tolerance"] == item["slots"]["tolerance"]:  # else this image told how wrong its model is
        kept["slots"] = before["slots"]
    known: TrackedObject = {**item, **kept}  # type: ignore[typeddict-item]
    return known


def _aligned(task: Task, poses: Floats) -> Aligned | None:
    """The objects as the image shows them at some poses; None where it shows nothing of them."""
    start = Start(poses, np.tile(_FIXED, (len(poses), 1, 1)))
    return align(task.image, task.controls, start, task.intrinsics, task.memory, task.search)


def _others(task: Task, item: TrackedObject, at: int, others: Sequence[Alternative]) -> list[Other]:
    """Poses that an object, the one at that place of the task, is compared with, each moved to where the image has
    it."""
    others = [other for other in others if len(other["controls"]["points"])]
    if not others:
        return []
    information = inverse(item["covariance"][None])[0]
    aligned = _at_others(task.image, item, others, information, task.intrinsics, task.search)
    if aligned is None:
        return []
    nats = explains(aligned) + dyed(aligned, task.palette, [at] * len(others))
    names = ["compared before" if other["kept"] else "imagined" for other in others]
    return [
        _other(name, item, pose, dashes(other["controls"]), said)
        for name, other, pose, said in zip(names, others, aligned.poses, nats.tolist(), strict=True)
    ]


def _other(name: str, item: TrackedObject, pose: Floats, edges: Floats, nats: float) -> Other:
    distance_m, angle_rad = pose_error(pose, item["pose"])
    return Other(name, pose, edges, nats, 1000.0 * distance_m, float(np.degrees(angle_rad)))


def _said(aligned: Aligned, parts: Shares, at: int) -> tuple[float, float, float, float]:
    """What the edges of one of the objects say of its pose: found, missing, looks and wholes of `Evidence`."""
    own = aligned.stage.controls.owners == at
    peaks, wholes = parts.peaks[own], parts.wholes[np.unique(aligned.stage.edges[own])]
    found, missing = float(np.maximum(peaks, 0.0).sum()), float(np.minimum(peaks, 0.0).sum())
    return found, missing, float(parts.looks[own].sum()), float(wholes.sum())


def _edges(aligned: Aligned, parts: Shares, at: int, intrinsics: Array) -> tuple[Edge, ...]:
    """One of the objects' edges, those that speak for its pose most first."""
    numbers = np.unique(aligned.stage.edges[aligned.stage.controls.owners == at])
    edges = (_edge(aligned, parts, each, intrinsics) for each in numbers)
    return tuple(sorted(edges, key=lambda edge: -edge.nats))


def _edge(aligned: Aligned, parts: Shares, number: int, intrinsics: Array) -> Edge:
    stage, matches = aligned.stage, aligned.matches
    rows = np.nonzero(stage.edges == number)[0]
    pixels, along = stage.lines.pixels[rows], _DASH_PX * stage.lines.normals[rows, ::-1] * (1.0, -1.0)
    weights, seen = expected(aligned)[rows], aligned.supported[rows]
    off = matches.pixels[rows] - aligned.off[rows]
    count = float(weights[seen].sum())
    off_px = -float((weights * np.where(seen, off, 0.0)).sum()) / count if count else float("nan")
    moves = moves_of(aligned.poses, stage.controls, stage.lines, rows, intrinsics)
    metres = 1.0 / float(np.linalg.norm(moves, axis=1).mean())  # a pixel, there
    return Edge(
        int(stage.controls.edges[rows[0]]),
        KINDS[stage.controls.kinds[rows[0]]],
        pixels.mean(axis=0),
        float(weights.sum()),
        count,
        off_px,
        1000.0 * off_px * metres,
        float((parts.peaks + parts.looks)[rows].sum() + parts.wholes[number]),
        np.stack((pixels - along, pixels + along), axis=1),
    )


def _row(edge: Edge) -> tuple[str, ...]:
    off = [f"{each:+.2f}" if np.isfinite(each) else "" for each in (edge.off_px, edge.off_mm)]
    at = f"{edge.at[0]:.0f}, {edge.at[1]:.0f}"
    return str(edge.number), edge.kind, at, f"{edge.expected:.1f}", f"{edge.seen:.1f}", *off, f"{edge.nats:+.1f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown whose columns stand below one another as text, too."""
    lines = [head, *rows]
    widths = [max(len(line[at]) for line in lines) for at in range(len(head))]
    texts = [
        "| " + " | ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    ]
    return "\n".join([texts[0], "|" + "|".join("-" * (width + 1) + ":" for width in widths) + "|", *texts[1:]])
