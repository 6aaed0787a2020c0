"""Small nodes and edge functions that test deployments name, right ones and wrong ones."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path

from hierax.runtime import Elements, Node, Probe, Step, Tick, Value, World

GAIN = 3
"""No class and no function."""


class Counter(World):
    """Counts epochs up; finished after `last`."""

    def __init__(self, step: int = 1, last: int | None = None) -> None:
        if step <= 0:
            raise ValueError(f"step must be positive, got {step}")
        self.step = step
        self.last = last

    def initial_belief(self) -> Value:
        return 0

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return belief + self.step

    def finished(self, belief: Value) -> bool:
        return self.last is not None and belief >= self.last

    def metrics(self, belief: Value) -> dict[str, float]:
        return {"count": float(belief)}


class Summer(Node):
    """Sums what it observes."""

    def __init__(self, weights: tuple[float, ...] = (1.0,), scale: float = 1.0) -> None:
        self.weights = weights
        self.scale = scale

    def initial_belief(self) -> Value:
        return 0.0

    def observe(self, observations: Elements, belief: Value) -> Value:
        return belief + sum(observations) * self.scale


class Waiting(Summer):
    """Its λ is async."""

    async def select_policy(self, tasks: Elements) -> str:
        return self.initial_policy


class Needy(Summer):
    """Cannot be made without its parameter."""

    def __init__(self, model: str) -> None:
        super().__init__()
        self.text = Path(model).read_text()


class Leaving(Counter):
    """Ends the process where it is made."""

    def __init__(self) -> None:
        raise SystemExit(0)


class Broken(Summer):
    """Its constructor has a fault."""

    def __init__(self, weights: tuple[float, ...] = ()) -> None:
        super().__init__()
        self.first = {}["missing"]


class Unfinished(Node):
    """Still abstract."""

    @abstractmethod
    def more(self) -> None:
        """To be defined."""


class Unsendable(Summer):
    """Its initial belief cannot travel."""

    def initial_belief(self) -> Value:
        return {"pose": object()}


class Faulty(Summer):
    """Its initial belief cannot be had."""

    def initial_belief(self) -> Value:
        raise RuntimeError("no simulator")


class Misshapen(Summer):
    """Its τ takes too much."""

    def observe(self, observations: Elements, belief: Value, more: Value) -> Value:  # type: ignore[override]
        return belief


class Failing(Summer):
    """Its τ raises."""

    def observe(self, observations: Elements, belief: Value) -> Value:
        raise RuntimeError("the camera is gone")


class Keeper(Probe):
    """Keeps steps."""

    def __init__(self, file: str = "") -> None:
        self.file = file
        self.steps: list[Step] = []

    def record(self, step: Step) -> None:
        self.steps.append(step)


class Scale:
    """An edge function with a parameter."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def __call__(self, belief: Value) -> Elements:
        return (belief * self.factor,)


class NotCallable:
    """No edge function."""


def seen(belief: Value, offset: float = 0.0, tick: Tick | None = None) -> Elements:
    """An edge function with a further parameter."""
    return (belief + offset,)


def wanted(actions: Elements) -> Elements:
    """Task parameters."""
    return actions


def two(belief: Value, more: Value) -> Elements:
    """An edge function that takes too much."""
    return (belief, more)
