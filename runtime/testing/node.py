"""`check_node`: what every node has to do, as one function to call from a test."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from hierax.runtime.core.binding import BoundNode, Call, OperatorSetting, epoch_time_s, is_finished, metrics_of
from hierax.runtime.core.difference import difference
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.errors import HieraxError, OperatorError
from hierax.runtime.core.node import Node, World
from hierax.runtime.core.probe import Step
from hierax.runtime.loading.node_loader import wait_for
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.values import decode_value, encode_value

Inputs = Sequence[Elements]
"""The elements of one epoch after the other."""

EPOCHS = 3
"""How many are done where there are fewer inputs: they are given again from the first."""

MAX_POLICIES = 32
"""How many policies a node may have for all of them to be called."""

NAME, BELOW, ABOVE = "node", "below", "above"


class Input(NamedTuple):
    """What comes to a node in an epoch."""

    epoch: int
    time_s: float
    observations: Elements
    tasks: Elements
    context: Elements


class _Called(NamedTuple):
    """A call that was made: the encoded arguments and result, and the result itself, which must not change later."""

    call: Call
    epoch: int
    time_s: float
    arguments: bytes
    encoded: bytes
    result: Value


def check_node(
    node: Node | Callable[[], Node],
    *,
    observations: Inputs = (),
    tasks: Inputs = (),
    context: Inputs = (),
    epochs: int | None = None,
    seed: int = 0,
    name: str = NAME,
    below: Sequence[str] = (BELOW,),
    above: Sequence[str] | None = None,
) -> list[Step]:
    """Check a node: that its operators are functions of values, and nothing else.

    Args:
        node: or what makes one, such as its class; then a second one has to do the same.
        observations, tasks, context: what it is given in the first epoch, the second one, …
        epochs: how many; by default as many as the longest of these, and at least `EPOCHS`.
        seed: of its random numbers.
        name, below, above: what it finds in its ticks; without `above`, and without tasks and context, it is a root.

    Returns:
        What the node did in each epoch, for further assertions.

    Raises:
        AssertionError: it does not do what `Node` asks for; says which operator, when and how.
        HieraxError: no epoch is to be done.
    """
    check_epochs(epochs)
    made = node if isinstance(node, Node) else node()
    assert isinstance(made, Node), f"expected a Node, or what makes one, got {made!r:.60}"
    if above is None:
        above = (ABOVE,) if tasks or context else ()
    _check_elements(observations=observations, tasks=tasks, context=context)
    inputs = make_inputs(observations, tasks, context, epochs)
    trial = _Trial(made, name, below, above, seed)
    steps = trial.run(inputs)
    trial.repeat()
    trial.call_all_policies(steps)
    trial.check_results_are_kept()
    trial.check_belief_functions(steps)
    if not isinstance(node, Node):
        other = _Trial(node(), name, below, above, seed)
        _same_steps(steps, other.run(inputs), f"{name}: another object of its class")
    return steps


def _check_elements(**given: Inputs) -> None:
    """Each epoch has a tuple or list of elements: of a lone map, whose comma was forgotten, the keys would be taken."""
    for kind, epochs in given.items():
        assert isinstance(epochs, (tuple, list)), (
            f"{kind}: expected a list with a tuple for each epoch, got {shown(epochs)}"
        )
        wrong = [place for place, elements in enumerate(epochs) if not isinstance(elements, (tuple, list))]
        assert not wrong, f"{kind}[{wrong[0]}]: expected a tuple of elements, got {shown(epochs[wrong[0]])}"


def check_epochs(epochs: int | None) -> None:
    """Raise `HieraxError` if there are none to be done: a test of nothing never fails."""
    if epochs is not None and epochs < 1:
        raise HieraxError(f"epochs: expected a whole number from 1 on, got {epochs!r:.60}")


def make_inputs(observations: Inputs, tasks: Inputs, context: Inputs, epochs: int | None = None) -> list[Input]:
    """Inputs epoch by epoch; what is shorter begins again."""
    longest = max(len(observations), len(tasks), len(context))
    count = max(longest, EPOCHS) if epochs is None else epochs

    def at(elements: Inputs, index: int) -> Elements:
        return tuple(elements[index % len(elements)]) if elements else ()

    given = (observations, tasks, context)
    return [Input(index + 1, float(index), *(at(each, index) for each in given)) for index in range(count)]


class _Trial:
    """A node whose every call is checked."""

    def __init__(self, node: Node, name: str, below: Sequence[str], above: Sequence[str], seed: int) -> None:
        self._name = name
        self._node = node
        try:
            below = () if isinstance(node, World) else tuple(below)
            self._bound = BoundNode(name, node, below, tuple(above), OperatorSetting(seed, wait_for))
        except HieraxError as error:
            raise AssertionError(str(error)) from error
        self._calls: list[_Called] = []

    def run(self, inputs: Sequence[Input]) -> list[Step]:
        """Every epoch, in order, as the engine does it."""
        bound, node = self._bound, self._node
        belief = self._call(bound.initial_belief, 0, 0.0)
        policy = node.initial_policy
        steps: list[Step] = []
        for epoch, time_s, observations, tasks, context in inputs:
            if isinstance(node, World):
                time_s = self._expected(partial(epoch_time_s, self._name, node, belief, epoch))
                sensed = belief
            else:
                sensed = self._call(bound.observe, epoch, time_s, observations, belief)
            if bound.above:
                self._call(bound.select_policy, epoch, time_s, tasks)
                policy = self._expected(partial(bound.choose, epoch, time_s, tasks))  # says what is wrong with it
            actions = self._call(bound.policies[policy], epoch, time_s, sensed)
            belief = self._call(bound.predict, epoch, time_s, context, actions, sensed)
            steps.append(Step(epoch, 0, time_s, observations, sensed, tasks, context, policy, actions, belief))
        return steps

    def repeat(self) -> None:
        """Every call once more, the last one first: what a node keeps in the object would show."""
        for called in reversed(self._calls):
            result = self._made(called.call, called.epoch, called.time_s, decode_value(called.arguments))
            where = f"{self._name}: {called.call.operator} in epoch {called.epoch}"
            what = "gave another result when it was called again later: it depends on more than its arguments"
            self._same(called.encoded, self._encoded(called.call, called.epoch, result), f"{where} {what}")

    def call_all_policies(self, steps: Sequence[Step]) -> None:
        """Also those that were not chosen."""
        for policy in sorted(self._bound.policies)[:MAX_POLICIES]:
            for step in steps:
                self._call(self._bound.policies[policy], step.epoch, step.time_s, step.sensed)

    def check_results_are_kept(self) -> None:
        """What was returned belongs to the run: nothing changes it afterwards."""
        for called in self._calls:
            where = f"{self._name}: what {called.call.operator} returned in epoch {called.epoch}"
            now = self._encoded(called.call, called.epoch, called.result)
            self._same(called.encoded, now, f"{where} was changed later; return a new value every time")

    def check_belief_functions(self, steps: Sequence[Step]) -> None:
        """`take_over`, `metrics` and, of a world, `finished`, for every belief."""
        node, name = self._node, self._name
        beliefs = [(0, self._made(self._bound.initial_belief, 0, 0.0, ()))] + [(s.epoch, s.belief) for s in steps]
        for epoch, belief in beliefs:
            encoded = encode_value(belief)
            where = f"{name}: take_over of its own belief after epoch {epoch}"
            try:
                taken = node.take_over(decode_value(encoded))
            except Exception as error:
                raise AssertionError(f"{where}: it refuses: {type(error).__name__}: {error}") from error
            self._same(encoded, encode_value(taken), f"{where} changed the belief")
            self._expected(partial(metrics_of, name, node, belief, epoch))
            if isinstance(node, World):
                self._expected(partial(is_finished, name, node, belief, epoch))
            what = f"{name}: metrics or finished changed the belief of epoch {epoch}"
            self._same(encoded, encode_value(belief), what)

    def _call(self, call: Call, epoch: int, time_s: float, *arguments: Value) -> Any:
        """A call with arguments as they come from a message or checkpoint, twice."""
        where = f"{self._name}: {call.operator} in epoch {epoch}"
        encoded_arguments = encode_value(arguments)
        given = decode_value(encoded_arguments)
        result = self._made(call, epoch, time_s, given)
        names = [f"argument {number}" for number in range(1, len(arguments) + 1)]
        what = f"{where} changed what it was given; make a copy, or a new value"
        self._same(encoded_arguments, encode_value(given), what, names)
        encoded = self._encoded(call, epoch, result)
        again = self._made(call, epoch, time_s, decode_value(encoded_arguments))
        what = "gave two results for the same arguments; random numbers come from tick.rng, time from tick.time_s"
        self._same(encoded, self._encoded(call, epoch, again), f"{where} {what}")
        self._calls.append(_Called(call, epoch, time_s, encoded_arguments, encoded, result))
        return result

    def _made(self, call: Call, epoch: int, time_s: float, arguments: Sequence[Value]) -> Any:
        if call.operator.startswith("policy"):
            return self._expected(partial(call.elements, epoch, time_s, *arguments))
        return self._expected(partial(call, epoch, time_s, *arguments))

    def _expected(self, do: Callable[[], Any]) -> Any:
        try:
            return do()
        except OperatorError as error:
            raise AssertionError(str(error)) from error

    def _encoded(self, call: Call, epoch: int, result: Value) -> bytes:
        try:
            return encode_value(result)
        except SchemaError as error:
            raise AssertionError(f"{self._name}: {call.operator} in epoch {epoch}: its result {error}") from error

    def _same(self, expected: bytes, got: bytes, what: str, names: Sequence[str] = ()) -> None:
        if expected != got:
            where = difference(decode_value(expected), decode_value(got), names)
            raise AssertionError(f"{what} ({where})" if where else what)


def _same_steps(expected: Sequence[Step], got: Sequence[Step], what: str) -> None:
    for one, other in zip(expected, got, strict=True):
        for field in ("sensed", "policy", "actions", "belief"):
            mine, others = getattr(one, field), getattr(other, field)
            if encode_value(mine) != encode_value(others):
                where = difference(mine, others)
                raise AssertionError(f"{what} gave another {field} in epoch {one.epoch} ({where}): it keeps something")
