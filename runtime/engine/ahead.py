"""What the world does ahead, while the other nodes are still at work on an epoch: it predicts, and senses for the next.

Both follow from its actions alone, as long as it gets no context; where it gets one, it predicts again. Nothing of that
is sent before the epoch is over. So it changes no digest, only when a processor is at work."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hierax.runtime.core.binding import BoundNode, Call, epoch_time_s, is_finished
from hierax.runtime.core.difference import is_due
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.node import World

Senses = Sequence[tuple[str, Call | None]]
Chosen = tuple[Elements, str, Elements]  # tasks, policy and actions of an epoch


class _Predicted(NamedTuple):
    chosen: Chosen  # that of the epoch, itself: an equal one may be another epoch's
    belief: Value


class _Sensed(NamedTuple):
    epoch: int
    belief: Value
    senses: Senses
    elements: Sequence[Elements]


class Ahead:
    """What was worked out ahead, until it is asked for."""

    def __init__(self) -> None:
        self._predicted: _Predicted | None = None
        self._sensed: _Sensed | None = None

    def predict(self, chosen: Chosen, predicted: Callable[[Elements, Elements], Value]) -> tuple[Value, ...]:
        """The belief that follows from what was chosen, without context; nothing where the operator fails. It is called
        again then, once it is known whether there is context, which it may need."""
        self._predicted = None
        try:
            belief = predicted((), chosen[2])
        except OperatorError:
            return ()
        self._predicted = _Predicted(chosen, belief)
        return (belief,)

    def sense(self, node: BoundNode, world: World, senses: Senses, epoch: int, belief: Value) -> None:
        """What goes up in an epoch that begins in a belief, unless the run ends before. An operator that fails is left
        to fail in its epoch; and where it will be looked at whether operators leave alone what they are given, they are
        called then."""
        self._sensed = None
        try:
            if is_due(epoch) or is_finished(node.name, world, belief, epoch - 1):
                return
            time_s = epoch_time_s(node.name, world, belief, epoch)
            elements = [sense.elements(epoch, time_s, belief) if sense else () for _, sense in senses]
        except OperatorError:
            return
        self._sensed = _Sensed(epoch, belief, senses, elements)

    def belief(self, chosen: Chosen, context: Elements) -> tuple[Value, ...]:
        """The belief that was predicted of what was chosen, if it was, and holds with this context; else nothing."""
        predicted, self._predicted = self._predicted, None
        return (predicted.belief,) if predicted is not None and predicted.chosen is chosen and not context else ()

    def observations(self, epoch: int, belief: Value, senses: Senses) -> Sequence[Elements] | None:
        """What was sensed for this epoch in this belief, by upper neighbour, if it was."""
        sensed, self._sensed = self._sensed, None
        if sensed is None or sensed.epoch != epoch or sensed.belief is not belief or sensed.senses is not senses:
            return None
        return sensed.elements
