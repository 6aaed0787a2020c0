"""Visual servoing: a camera follows a sliding object (example 2 of arXiv 1801.02270).

An object slides from rest down a frictionless plane of 60°: x(t) = ½kt². A camera node filters what it sees of it and
moves the camera there; a node above knows how things slide and predicts where the object will be. That prediction is
the context. All positions are in metres along the plane, from where the object starts.

Where the node above takes part in few epochs only, and what it says counts in many, it says a course (`Course`) in the
place of a position: where the object will be, epoch by epoch."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from hierax.runtime import NO_TICK, Elements, Node, Step, Tick, Value, World
from hierax.runtime.core.node import Policy, do_nothing
from hierax.runtime.core.showing import GREY, Curve, Things, colour_of

ACCELERATION = 8.49  # k, in m/s²: g · sin 60°
STEP_S = 0.05  # δt: how much time an epoch takes, in seconds
NOISE = 0.1  # standard deviation of the camera's measurement, in metres
GAIN = 0.25  # how much of a measurement the camera node believes; of its expectation it believes the rest
HOLD = "hold"
MOVE = "move"


def position_at(time_s: float) -> float:
    """x(t) = ½kt², in metres."""
    return 0.5 * ACCELERATION * time_s**2


def check_seconds(**given: float) -> None:
    """Raises ValueError if one is no positive number."""
    for name, value in given.items():
        if not isinstance(value, (int, float)) or not 0 < value < math.inf:
            raise ValueError(f"{name}: expected a number of seconds, more than 0, got {value!r}")


class CameraPolicies(Mapping[str, Policy]):
    """Π₀: ``hold``, and for every position x the policy ``move x``, whose action is {x}."""

    def __getitem__(self, name: str) -> Policy:
        if name == HOLD:
            return do_nothing
        order, _, target = name.partition(" ")
        if order != MOVE:
            raise KeyError(name)
        try:
            command = (float(target),)
        except ValueError:
            raise KeyError(name) from None
        return lambda belief: command

    def __iter__(self) -> Iterator[str]:
        return iter((HOLD,))

    def __len__(self) -> int:
        return 1


class SlidingWorld(World):
    """N₀: the object on the plane, and the camera.

    Belief: ``epochs`` that have passed (the time is δt times that), ``camera``: the position last commanded, and sums
    over the epochs: ``error_sum`` of the errors |x(t) - camera|, in metres, ``square_sum`` of their squares. The error
    of an epoch is between the object at the time of that epoch's observation and the position that is commanded in it.
    `step_s`: δt. Raises ValueError: that is no positive number.
    """

    initial_policy = HOLD

    def __init__(self, step_s: float = STEP_S) -> None:
        check_seconds(step_s=step_s)
        self._step_s = step_s

    def initial_belief(self) -> Value:
        """Object and camera at 0, at time 0."""
        return {"epochs": 0, "camera": 0.0, "error_sum": 0.0, "square_sum": 0.0}

    def select_policy(self, tasks: Elements) -> str:
        """λ: of a task {x}, to move there; the name has x to the bit."""
        return f"{MOVE} {float(tasks[0])!r}" if tasks else HOLD

    def policies(self) -> Mapping[str, Policy]:
        """Π: leave the camera, or move it, wherever to."""
        return CameraPolicies()

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ: the camera moves to where it is told, in metres, or stays; the error is read, δt passes."""
        camera = actions[0] if actions else belief["camera"]
        error = abs(position_at(self.time_s(belief, 0)) - camera)
        sums = {"error_sum": belief["error_sum"] + error, "square_sum": belief["square_sum"] + error**2}
        return {"epochs": belief["epochs"] + 1, "camera": camera, **sums}

    def time_s(self, belief: Value, epoch: int) -> float:
        """t, in seconds; 0 in the first epoch."""
        return float(belief["epochs"] * self._step_s)

    def metrics(self, belief: Value) -> Mapping[str, float]:
        """Mean and root mean square of the error over all epochs, in metres; none before the first."""
        epochs = belief["epochs"]
        if not epochs:
            return {}
        rms = math.sqrt(belief["square_sum"] / epochs)
        return {"tracking_error_mean": belief["error_sum"] / epochs, "tracking_error_rms": rms}

    def show(self, step: Step, before: Value) -> Things:
        """The object and the camera beside one another, and how far they are apart."""
        true, camera = position_at(step.time_s), step.belief["camera"]
        return {
            "/position_m/object": Curve(true, GREY),
            "/position_m/camera": Curve(camera, colour_of(1)),
            "/error_m/camera": Curve(abs(true - camera), colour_of(1)),
        }


class CameraNode(Node):
    """N₁: where the object is in the camera's eyes. Belief: ``position`` x, in metres."""

    def initial_belief(self) -> Value:
        """The object is believed to be at x = 0."""
        return {"position": 0.0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ₁({x}, y) = 0.75y + 0.25x; of no observation, y."""
        if not observations:
            return belief
        return {"position": (1.0 - GAIN) * belief["position"] + GAIN * observations[0]}

    def show(self, step: Step, before: Value) -> Things:
        """Where the object was seen, and where it is believed to be."""
        seen = {"/position_m/seen": Curve(step.observations[0], colour_of(4))} if step.observations else {}
        return {**seen, "/position_m/believed": Curve(step.sensed["position"], colour_of(2))}

    def policies(self) -> Mapping[str, Policy]:
        """π₁(x) = {x}: move the camera to the object."""
        return {self.initial_policy: position}

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        """γ₁: of a context {x}, that x, of a course, where that is next; without one, the commanded action."""
        if not context:
            return {"position": actions[0]}
        expected = context[0]
        return {"position": position_on(expected, tick.time_s) if isinstance(expected, Mapping) else expected}


class MotionNode(Node):
    """N₂: how the object moves. Belief: ``position`` x in metres, ``velocity`` v in m/s.

    `step_s`: δt, from one of its turns to the next. Raises ValueError: that is no positive number."""

    def __init__(self, step_s: float = STEP_S) -> None:
        check_seconds(step_s=step_s)
        self._step_s = step_s

    def initial_belief(self) -> Value:
        """The object rests at the start: ⟨0, 0⟩."""
        return {"position": 0.0, "velocity": 0.0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        """τ₂({x}, ⟨y, v⟩) = ⟨x, v⟩; of no observation, ⟨y, v⟩."""
        if not observations:
            return belief
        return {**belief, "position": observations[0]}

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        """γ₂ = ⟨x + vδt + ½kδt², v + kδt⟩."""
        x, v, step_s = belief["position"], belief["velocity"], self._step_s
        return {"position": x + v * step_s + position_at(step_s), "velocity": v + ACCELERATION * step_s}

    def show(self, step: Step, before: Value) -> Things:
        """Where the object is predicted to be next, and how fast it is believed to be."""
        return {
            "/position_m/predicted": Curve(step.belief["position"], colour_of(3)),
            "/velocity_m_s/believed": Curve(step.sensed["velocity"], colour_of(3)),
        }


class MeasuredPosition:
    """φ from the world to N₁: {½kt² + ν}; ν is normal, with this standard deviation in metres. `step_s` is the world's.
    Raises ValueError: the one is no number of 0 or more, or the other no positive one."""

    def __init__(self, noise: float = NOISE, step_s: float = STEP_S) -> None:
        check_seconds(step_s=step_s)
        is_number = isinstance(noise, (int, float)) and math.isfinite(noise)
        if not is_number or noise < 0:
            raise ValueError(f"noise: expected a number of metres, at least 0, got {noise!r}")
        self._noise, self._step_s = float(noise), step_s

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """One observation, in metres; its noise is keyed by the run's seed and the epoch."""
        true = position_at(belief["epochs"] * self._step_s)
        return (true + self._noise * float(tick.rng.standard_normal()),)


def position(belief: Value) -> Elements:
    """φ₁₂, ϱ₂₁ and π₁: the belief's position, {x}."""
    return (belief["position"],)


class Course:
    """ϱ₂₁ where what is said counts in many epochs: where the object will be at the end of each epoch from this one on.

    Args:
        step_s: how long an epoch takes.
        horizon_s: up to which time after the epoch's own; at least one epoch.
        turn_s: how long after that time the node above believes the object to be where its belief says: its δt.

    Raises ValueError: one is no positive number."""

    def __init__(self, step_s: float, horizon_s: float, turn_s: float = STEP_S) -> None:
        check_seconds(step_s=step_s, horizon_s=horizon_s, turn_s=turn_s)
        self._step_s, self._turn_s = step_s, turn_s
        self._after_s = step_s * np.arange(1, max(round(horizon_s / step_s), 1) + 1)

    def __call__(self, belief: Value, tick: Tick = NO_TICK) -> Elements:
        """One element: ``time_s`` of the epoch, ``step_s``, and ``positions`` (n,) in metres."""
        away_s = self._after_s - self._turn_s
        positions = belief["position"] + belief["velocity"] * away_s + 0.5 * ACCELERATION * away_s**2
        return ({"time_s": tick.time_s, "step_s": self._step_s, "positions": positions},)


def position_on(course: Mapping[str, Value], time_s: float) -> float:
    """Where the object is at the end of the epoch of this time, in metres; after the horizon, where it is there."""
    positions, epochs = course["positions"], round((time_s - course["time_s"]) / course["step_s"])
    return float(positions[min(epochs, len(positions) - 1)])


def camera_task(actions: Elements) -> Elements:
    """ψ₁₀: the commanded positions are the world's task."""
    return actions
