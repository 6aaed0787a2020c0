"""Nodes and edge functions for simulations: every result depends on everything it should.

They hash all their arguments, in order, so that a lost, doubled, stale or reordered
input, a wrong belief or another random number shows in every state above and below."""

from collections.abc import Callable, Mapping
from functools import partial
from hashlib import blake2b

from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.node import NO_TICK, Node, Tick, World
from hierax.schemas.values import encode_value

MODULE = __name__


def mark(*parts: Value) -> bytes:
    return blake2b(encode_value(parts), digest_size=8).digest()


def _elements(text: bytes) -> Elements:
    count = text[0] % 4
    return ((), (text,), (text[0], text), (text, text))[count]


class Mixer(Node):
    """Hashes its inputs into its belief."""

    initial_policy = "p0"

    def __init__(self, name: str, policies: int = 1, generation: int = 0) -> None:
        self.name = name  # goes into every hash
        self.generation = generation  # goes into every hash, too: a node that replaces another has its own
        self._policies = policies  # how many; at least 1

    def initial_belief(self) -> Value:
        return {"mark": mark(self.name, self.generation), "epochs": 0}

    def observe(self, observations: Elements, belief: Value) -> Value:
        return self._know("observe", belief, observations)

    def select_policy(self, tasks: Elements) -> str:
        return f"p{mark(self.name, tasks)[0] % self._policies}" if tasks else self.initial_policy

    def policies(self) -> Mapping[str, Callable[..., Elements]]:
        return {f"p{index}": partial(self.choose, f"p{index}") for index in range(self._policies)}

    def choose(self, policy: str, belief: Value) -> Elements:
        return _elements(mark(self.name, policy, belief["mark"]))

    def predict(self, context: Elements, actions: Elements, belief: Value) -> Value:
        return self._know("predict", belief, context, actions)

    def take_over(self, belief: Value) -> Value:
        return self._know("take_over", belief)

    def _know(self, what: str, belief: Value, *parts: Value) -> Value:
        known = mark(self.name, self.generation, what, belief["mark"], *parts)
        return {"mark": known, "epochs": belief["epochs"] + (what == "predict")}


class Drawer(Mixer):
    """Does as `Mixer` does, and its operators also hash their tick and random numbers."""

    def observe(self, observations: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return self._know("observe", belief, observations, drawn(tick))

    def predict(self, context: Elements, actions: Elements, belief: Value, tick: Tick = NO_TICK) -> Value:
        return self._know("predict", belief, context, actions, drawn(tick))


class MixingWorld(Mixer, World):
    """N₀; its clock depends on its belief."""

    def __init__(self, name: str, policies: int = 1, generation: int = 0, last: int | None = None) -> None:
        super().__init__(name, policies, generation)
        self._last = last  # the epoch with which it has finished; None: it never has

    def time_s(self, belief: Value, epoch: int) -> float:
        return epoch + float(belief["mark"][0]) / 256.0

    def finished(self, belief: Value) -> bool:
        return bool(belief["epochs"] == self._last)


class ActingWorld(MixingWorld):
    """N₀ with a device outside, which the simulation puts in the place of `act`."""

    def act(self, actions: Elements, tick: Tick = NO_TICK) -> None:
        """Where the device is not put in its place, nothing moves."""
        return


class Mix:
    """An edge function: elements that depend on all of its argument."""

    def __init__(self, name: str) -> None:
        self.name = name  # goes into the hash

    def __call__(self, argument: Value) -> Elements:
        return _elements(mark(self.name, argument))


class DrawingMix(Mix):
    """Does as `Mix` does, with its tick and random numbers."""

    def __call__(self, argument: Value, tick: Tick = NO_TICK) -> Elements:
        return _elements(mark(self.name, argument, drawn(tick)))


def drawn(tick: Tick) -> Value:
    return (tick.epoch, tick.time_s, tick.below, tick.above, int(tick.rng.integers(1 << 32)))
