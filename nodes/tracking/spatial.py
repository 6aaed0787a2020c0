"""The spatial node: a physics simulator as mental imagery (example 3 of the paper)."""

import math
from collections.abc import Mapping, Sequence
from math import sqrt
from typing import ClassVar

import numpy as np

from hierax.nodes.tracking import constants as const
from hierax.nodes.tracking import schema
from hierax.nodes.tracking.display import spatial_things
from hierax.nodes.tracking.errors import check_between
from hierax.nodes.tracking.imagery.alternatives import Footing, elsewhere, footing_of, resting, set_down, tops_behind
from hierax.nodes.tracking.imagery.physics import GRAVITY_M_S2, Motion, Simulator, Solid
from hierax.nodes.tracking.math.geometry import (
    NO_POSES,
    Floats,
    exp_se3,
    exp_so3,
    invert,
    log_se3,
    log_so3,
    make_pose,
    unit,
)
from hierax.nodes.tracking.model.mesh import Mesh
from hierax.nodes.tracking.model.symmetry import alike, found_symmetry
from hierax.nodes.tracking.render import is_missing
from hierax.runtime import NO_TICK, Node, Step, Tick, Value
from hierax.runtime.core.showing import Things


class SpatialNode(Node):
    """Knows where bodies are in the world, how they move, and what physics lets them do next.

    τ moves the bodies to the poses that the arm corrected and learns their velocities from the differences of these,
    filtered. Not from how far they are from the predicted ones: a body that is held in the air would seem to move up as
    fast as physics has it fall. γ lets one frame interval pass: over a table, with gravity and contacts (bodies that
    interpenetrate are pushed apart, things settle); without one, at constant velocity.

    The belief is a `SpatialBelief`, see `hierax.nodes.tracking.schema`.

    Args:
        objects: the bodies to begin with: each with ``id``, ``obj_id``, ``pose`` and ``model``.
        table: whether the plane z = 0 of the world carries them, z pointing up: one that is lost is then missing, and
            looked for everywhere on it.
        velocity_gain: how far the velocity follows the last observed one, 0 to 1.
        damping: how fast a body without a table slows down, 1/s.
        max_sigmas: how far physics may move a tracked body from where it goes by itself,
            in standard deviations of the arm's pose.
        friction: of the bodies.

    Attributes:
        table_middle_m: (3,) where the table is shown; None: at the world's origin.
    """

    table_middle_m: ClassVar[Floats | None] = None

    def __init__(
        self,
        objects: Sequence[schema.FirstBody],
        table: bool = False,
        velocity_gain: float = const.VELOCITY_GAIN,
        damping: float = const.DAMPING,
        max_sigmas: float = const.PHYSICS_SIGMAS,
        friction: float = const.BODY_FRICTION,
    ) -> None:
        check_between(0, 1, "a number", velocity_gain=velocity_gain)
        for name, number in (("damping", damping), ("max_sigmas", max_sigmas), ("friction", friction)):
            if not 0.0 <= number < math.inf:
                raise ValueError(f"{name} is {number}; expected a finite number not below 0")
        self._bodies = tuple(_body(item) for item in objects)
        self._table = table
        self._velocity_gain = velocity_gain
        self._damping = damping
        self._max_sigmas = max_sigmas
        self._simulator = Simulator()
        self._solids = {
            body["id"]: [Solid(body["model"]["vertices"], body["mass"], part * friction) for part in (1.0, 0.0)]
            for body in self._bodies
        }
        self._footings: dict[int, Footing] = {}  # by body, as they are asked for
        self._likenesses: dict[int, schema.Symmetry] = {}  # likewise

    def initial_belief(self) -> schema.SpatialBelief:
        """The bodies at their first poses, at rest; no camera yet."""
        return {
            "camera": None,
            "intrinsics": None,
            "size": None,
            "frame": None,
            "images": 0,
            "time_s": None,
            "interval_s": const.DEFAULT_INTERVAL_S,
            "sweeping": () if self._table else None,
            "bodies": self._bodies,
            "carried": (),
        }

    def observe(
        self, observations: tuple[schema.Seen, ...], belief: schema.SpatialBelief, tick: Tick = NO_TICK
    ) -> schema.SpatialBelief:
        """τ: the bodies where the arm saw them, the camera where it was."""
        seen = {item["id"]: item for item in observations if "pose" in item}
        cameras = [item for item in observations if "camera" in item]
        earlier = belief["time_s"]
        interval_s = tick.time_s - earlier if earlier is not None and tick.time_s > earlier else None
        bodies = tuple(
            self._moved(body, seen[body["id"]], interval_s) if body["id"] in seen else body for body in belief["bodies"]
        )
        sensed: schema.SpatialBelief = {
            **belief,
            "bodies": bodies,
            "images": belief["images"] + bool(cameras),
            "time_s": tick.time_s if observations else None,  # a gap is no interval
            "interval_s": belief["interval_s"] if interval_s is None else interval_s,
        }
        for camera in cameras:
            sensed = {**sensed, **camera}
        return sensed

    def predict(
        self, context: schema.Nothing, actions: schema.Nothing, belief: schema.SpatialBelief
    ) -> schema.SpatialBelief:
        """γ: one frame interval of physics."""
        interval_s = belief["interval_s"]
        bodies = [body for body in belief["bodies"] if not is_missing(body, belief)]
        motions = [Motion(body["pose"], body["velocity"]) for body in bodies]
        coasting = [self._coasted(motion, interval_s) for motion in motions]
        carried: list[tuple[int, int]] = []
        if not self._table:
            after = [_at(body, to) for body, to in zip(bodies, coasting, strict=True)]
        else:
            solids = [self._solids[body["id"]][_is_driven(body)] for body in bodies]
            settled = self._simulator.run(solids, motions, interval_s)
            ids = [body["id"] for body in bodies]
            carried = [
                (ids[upper], schema.TABLE if lower is None else ids[lower])
                for upper, lower in self._simulator.carried()
            ]
            after = [
                resting(_at(body, self._bounded(body, free, physical)), _is_carried(free, physical, interval_s))
                for body, free, physical in zip(bodies, coasting, settled, strict=True)
            ]
            after = [_hanging(body) for body in after]
        present = {body["id"]: self._looked_for(body, belief, interval_s) for body in after}
        sweeping = _swept_next(belief) if self._table else None
        every = tuple(present.get(body["id"]) or self._sought(body, sweeping or ()) for body in belief["bodies"])
        return {**belief, "bodies": every, "sweeping": sweeping, "carried": tuple(sorted(carried))}

    def metrics(self, belief: schema.SpatialBelief) -> Mapping[str, float]:
        """How many bodies the arm tracks and has lost, and the fastest one's speed in mm/s."""
        bodies = belief["bodies"]
        speeds = [float(np.linalg.norm(body["velocity"][:3])) for body in bodies]
        return {
            "tracked": float(sum(body["status"] == schema.TRACKED for body in bodies)),
            "lost": float(sum(body["status"] == schema.LOST for body in bodies)),
            "max_speed_mm_s": 1000.0 * max(speeds, default=0.0),
        }

    def show(self, step: Step, before: Value) -> Things:
        """The bodies, and what the camera is expected to see."""
        middle = np.zeros(3) if self.table_middle_m is None else self.table_middle_m
        return spatial_things(step, middle if self._table else None)

    def _moved(self, body: schema.Body, seen: schema.SeenObject, interval_s: float | None) -> schema.Body:
        """The body with what the arm says of it; one that it has lost stays where it was predicted."""
        heard: schema.Body = {
            **body,
            "status": seen["status"],
            "covariance": seen["covariance"],
            "sought": seen["sought"],
            "guesses": seen["guesses"],
            "seen": None,
            "unseen": 0,
        }
        if self._table and seen["status"] == schema.LOST:
            first = body["turn"] if body["status"] == schema.LOST else 0
            return {**heard, "velocity": np.zeros(6), "drift": np.zeros(6), "turn": first}
        if seen["status"] != schema.TRACKED:
            supposed = seen["pose"] if seen["status"] == schema.EXPECTED else body["pose"]
            return {**_adrift(heard, body, interval_s), "pose": supposed}
        pose, drift = seen["pose"], body["drift"]
        if interval_s is not None and body["seen"] is not None:
            before = body["seen"]
            turned = log_so3(pose[:3, :3] @ before[:3, :3].T)
            observed = np.concatenate((pose[:3, 3] - before[:3, 3], turned)) / interval_s
            change = self._gain((observed - drift) * interval_s, seen) * (observed - drift)
            drift = drift + _limited(change, const.ACCELERATION * interval_s)
        needed = const.STOPPED_SIGMAS if body["velocity"].any() else const.MOVES_SIGMAS
        moves = interval_s is not None and self._moves(drift * interval_s, seen, needed)
        velocity = drift if moves else np.zeros(6)
        return {**heard, "pose": pose, "velocity": velocity, "drift": drift, "seen": pose, "known": True}

    def _gain(self, change: Floats, seen: schema.SeenObject) -> float:
        """How far the velocity follows: all the way where it changes by more than errors of poses do."""
        square = _sigmas_squared(change, seen["pose"], 2.0 * seen["covariance"])
        return self._velocity_gain + (1.0 - self._velocity_gain) * square / (square + const.MOVES_SIGMAS**2)

    def _moves(self, step: Floats, seen: schema.SeenObject, needed: float) -> bool:
        """Whether a mean displacement from frame to frame is more than errors of the poses make: those of poses that
        follow one another cancel in a running mean of their differences but for a part."""
        share = 2.0 * self._velocity_gain**2 / (2.0 - self._velocity_gain)
        return _sigmas_squared(step, seen["pose"], share * seen["covariance"]) > needed**2

    def _coasted(self, motion: Motion, interval_s: float) -> Motion:
        """Constant velocity, slowly dying down."""
        pose, velocity = motion
        step = velocity * interval_s
        moved = make_pose(exp_so3(step[3:]) @ pose[:3, :3], pose[:3, 3] + step[:3])
        return Motion(moved, velocity * np.exp(-self._damping * interval_s))

    def _looked_for(self, body: schema.Body, belief: schema.SpatialBelief, interval_s: float) -> schema.Body:
        """A body with the poses at which it is to be looked for besides."""
        if belief["camera"] is not None and _is_to_be_set_down(body):
            return self._set_down(body, belief, belief["camera"][:3, 3])
        if not body["sought"] or not body["known"]:
            return {**body, "others": NO_POSES, "kept": 0}
        moved = [self._coasted(Motion(guess, body["velocity"]), interval_s).pose for guess in body["guesses"]]
        return _with_others(body, self._turned_least(body, np.array(moved).reshape(-1, 4, 4)))

    def _set_down(self, body: schema.Body, belief: schema.SpatialBelief, eye: Floats) -> schema.Body:
        """A body that is seen where it cannot rest, with the poses in which it may: on the table, or on what stands
        there."""
        number = body["id"]
        if number not in self._footings:
            self._footings[number] = footing_of(body["model"]["vertices"])
        below = [other for other in belief["bodies"] if other["stands"] and other["id"] != number]
        heights = [0.0, *tops_behind(body["pose"], below, eye)]
        others = set_down(body["pose"], self._footings[number], eye, heights, body["hangs"] // const.CONFIRMED)
        return {**body, "others": others, "kept": 0}

    def _sought(self, body: schema.Body, sweeping: tuple[int, ...]) -> schema.Body:
        """A missing body for the next image, with the poses that the arm guesses."""
        guesses = self._turned_least(body, body["guesses"])
        return {**body, "others": guesses, "kept": len(guesses), "turn": body["turn"] + (body["id"] in sweeping)}

    def _turned_least(self, body: schema.Body, guesses: Floats) -> Floats:
        """(n, 4, 4) poses at which a body that was seen before looks as at each guess (n, 4, 4), those to which it has
        turned least from where it was imagined last, falling over the way it went: outlines do not tell its sides,
        whatever is said of its symmetry."""
        if not self._table or not body["known"] or not len(guesses):
            return guesses
        number, model = body["id"], body["model"]
        if number not in self._likenesses:
            self._likenesses[number] = found_symmetry(Mesh(model["vertices"], model["faces"]))
        likeness = self._likenesses[number]
        return np.stack([alike(likeness, guess[None], _leaning(body, guess))[0] for guess in guesses])

    def _bounded(self, body: schema.Body, free: Motion, physical: Motion) -> Motion:
        """What physics says, drawn back towards the free motion as far as the arm's certainty of the pose asks. Where
        that is needed, something holds or drives the body that physics does not know of: its velocity stays the
        observed one."""
        if body["status"] != schema.TRACKED:
            return physical
        twist = log_se3(invert(free.pose) @ physical.pose)
        square = float(twist @ np.linalg.solve(body["covariance"], twist))
        sigmas = sqrt(max(0.0, square))
        if sigmas <= self._max_sigmas:
            return physical
        return Motion(free.pose @ exp_se3(self._max_sigmas / sigmas * twist), free.velocity)


def _body(item: schema.FirstBody) -> schema.Body:
    vertices = np.asarray(item["model"]["vertices"], dtype=np.float64)
    faces = np.asarray(item["model"]["faces"], dtype=np.int32)
    return {
        "id": item["id"],
        "obj_id": item["obj_id"],
        "pose": np.eye(4) if item["pose"] is None else np.asarray(item["pose"], dtype=np.float64),
        "velocity": np.zeros(6),
        "drift": np.zeros(6),
        "covariance": const.UNSEEN,
        "status": schema.EXPECTED if item["pose"] is not None else schema.LOST,
        "seen": None,
        "unseen": 0,
        "support": np.zeros(3),
        "stands": False,
        "hangs": 0,
        "known": False,
        "sought": False,
        "turn": 0,
        "guesses": NO_POSES,
        "others": NO_POSES,
        "kept": 0,
        "model": {**item["model"], "vertices": vertices, "faces": faces},
        "mass": const.DENSITY_KG_M3 * float(np.prod(_extents(vertices))),
    }


def _extents(vertices: Floats) -> Floats:
    """How large a model is along its axes, m. A plate may be modelled without any thickness: it has mass all the same,
    as what has none stands still in physics whatever falls on it, and turns no faster than one of paper."""
    extents: Floats = np.maximum(np.ptp(vertices, axis=0), const.THINNEST_M)
    return extents


def _swept_next(belief: schema.SpatialBelief) -> tuple[int, ...]:
    """Which bodies that are missing, or that the image does not support where they are expected, are looked for
    everywhere in the next image, those for which that was done least; those that were not found are looked for now and
    then."""
    missing = sorted(
        (body["turn"] if is_missing(body, belief) else body["unseen"] - 2, body["id"])
        for body in belief["bodies"]
        if _is_swept(body, belief)
    )
    now = belief["images"] % const.SWEPT_EVERY == 0
    return tuple(number for turn, number in missing[: const.SWEPT_TOGETHER] if turn < const.SWEPT_AT_ONCE or now)


def _is_swept(body: schema.Body, belief: schema.SpatialBelief) -> bool:
    """Whether a body may be anywhere: it is missing, or the second image in a row does not support it."""
    return is_missing(body, belief) or (body["sought"] and body["known"] and body["unseen"] > 1)


def _leaning(body: schema.Body, guess: Floats) -> Floats:
    """(4, 4) a body's pose, from which it leans the way it has gone to a guess (4, 4), the more the farther that is."""
    way = guess[:3, 3] - body["pose"][:3, 3]
    part = min(1.0, float(np.hypot(way[0], way[1])) / float(_extents(body["model"]["vertices"]).max()))
    axis = unit(np.array([-way[1], way[0], 0.0]))
    return make_pose(exp_so3(const.LEANING_RAD * part * axis) @ body["pose"][:3, :3], body["pose"][:3, 3])


def _limited(change: Floats, most: Floats) -> Floats:
    """A change of velocity, no larger than what forces make of it in a frame; more is an error of the poses."""
    sizes = np.array([np.linalg.norm(change[:3]), np.linalg.norm(change[3:])])
    return np.asarray(change * np.repeat(np.minimum(1.0, most / np.maximum(sizes, 1e-12)), 3))


def _sigmas_squared(step: Floats, pose: Floats, covariance: Floats) -> float:
    """How much a displacement in the world's frame is beside a covariance in the object's, in variances."""
    rotation = pose[:3, :3]
    turned = np.concatenate((rotation.T @ step[:3], rotation.T @ step[3:]))
    return float(turned @ np.linalg.solve(covariance, turned))


def _with_others(body: schema.Body, guesses: Floats) -> schema.Body:
    """A body as it is imagined for the next image, with poses to look for it at besides; guesses: (n, 4, 4) where it
    may be by then by what the arm saw."""
    covariance = body["covariance"] if body["status"] != schema.TRACKED else body["covariance"] + const.BODY_ASTRAY
    imagined = elsewhere(body["pose"], covariance, body["support"] * body["stands"], body["turn"])
    others = np.concatenate((guesses, imagined[min(len(guesses), const.AT_ONCE - const.GUESSES) :]))
    return {**body, "others": others, "kept": len(guesses), "turn": body["turn"] + 1}


def _hanging(body: schema.Body) -> schema.Body:
    """A body as it is imagined for the next image, with how long it was seen where it cannot rest."""
    hangs = body["status"] == schema.TRACKED and not body["stands"]
    return {**body, "hangs": body["hangs"] + 1 if hangs else 0}


def _is_to_be_set_down(body: schema.Body) -> bool:
    """Whether a body was seen where it cannot rest for so long that it is imagined where it can; later more seldom."""
    tries, due = divmod(body["hangs"], const.CONFIRMED)
    return due == 0 < tries and (tries <= const.FAILED_AT_ONCE or tries % const.FAILED_EVERY == 0)


def _is_carried(free: Motion, physical: Motion, interval_s: float) -> bool:
    """Whether something below keeps a body from falling, by what physics has it do."""
    return bool(free.pose[2, 3] - physical.pose[2, 3] < const.SINKS * 0.5 * GRAVITY_M_S2 * interval_s**2)


def _is_driven(body: schema.Body) -> bool:
    """Whether it slides: against friction, things that physics does not know of drive it, and will go on. What turns
    over does not: its foot needs the friction."""
    velocity = body["velocity"]
    speed, turning = float(np.linalg.norm(velocity[:2])), float(np.linalg.norm(velocity[3:5]))
    return bool(speed > 0.0 and abs(velocity[2]) < 0.3 * speed and turning < const.TURNING * speed)


def _adrift(heard: schema.Body, body: schema.Body, interval_s: float | None) -> schema.Body:
    """One that is not seen moves on, but nobody knows how long: of a body with what the arm has said of it, and before
    that, the uncertainty grows along its motion, and about the vertical."""
    step = body["velocity"] * (interval_s or 0.0)
    along = body["pose"][:3, :3].T @ step[:3]
    up = body["pose"][2, :3]
    turn = up * float(np.linalg.norm(step[:3])) / float(_extents(body["model"]["vertices"]).min())
    growth = const.UNSURE**2 * (2 * body["unseen"] + 1)
    grown = heard["covariance"].copy()
    grown[:3, :3] += growth * np.outer(along, along)
    grown[3:, 3:] += growth * np.outer(turn, turn)
    return {**heard, "covariance": grown, "unseen": body["unseen"] + 1}


def _at(body: schema.Body, motion: Motion) -> schema.Body:
    return {**body, "pose": motion.pose, "velocity": motion.velocity}
