"""Where an input came from, carried inside it: each set of elements has a tag in front.

The tags are put on and taken off around a node's own operators and edge functions, so what is computed does not depend
on them, and the engine sees only elements. A tag says which process made the elements, under which version of the
roster, in which epoch and attempt: of the world's, what it was told to begin; of any other node, what the inputs said
that it observed last. So nothing of the engine's own bookkeeping is relied upon."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from hierax.runtime.core.binding import BoundNode, Call
from hierax.runtime.core.elements import Elements, Value
from hierax.runtime.core.hierarchy import BoundEdge
from hierax.runtime.engine.table import ATTEMPTS_AHEAD, EPOCHS_AHEAD, ROSTERS_AHEAD
from hierax.runtime.sim.scenario import CONTRADICT, FORETELL
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Message

_MARK = "#"


class Turn(NamedTuple):
    """An attempt of an epoch, under a version of the roster."""

    version: int
    epoch: int
    attempt: int


@dataclass(eq=False, repr=False)
class Inspector:
    """Looks at all that goes into one process's operators."""

    name: str  # of the node, and of its process
    process: str  # of the node, and of its process
    violated: Callable[[str], None]  # told what is wrong
    process_of: Callable[[int, str], str | None]  # the process that runs a node under a version
    starts: Callable[[Turn], None]  # called when a node begins a turn, before its first operator
    calls: Callable[[Call, int], None]  # called before each operator, with the epoch; what it raises, that raises

    def __post_init__(self) -> None:
        self.turn = Turn(-1, 0, -1)  # that the node is in
        self.heard = self.turn  # the last one in which it had all from above

    def tag(self, elements: Elements) -> Elements:
        return ((_MARK, self.name, self.process, *self.turn), *elements)

    def observed(self, elements: Elements, senders: tuple[str, ...], version: int, epoch: int) -> Elements:
        """Look at what a node observes; it decides which turn this is."""
        tags, bare = _split(elements)
        turns = {Turn(*tag[3:]) for tag in tags}
        what = f"observations in epoch {epoch} under version {version}"
        if len(turns) != 1:
            self.violated(f"{self.name}: its {what} are of {sorted(turns)}")
        else:
            (turn,) = turns
            if turn.version < version or turn.epoch != epoch or turn[1:] <= self.turn[1:]:
                self.violated(f"{self.name}: its {what} are of {turn}; the last were of {self.turn}")
            self.turn = turn
        self._check(tags, senders, what)
        self.starts(self.turn)
        return bare

    def acts(self) -> None:
        """Note that the world acts: all that comes from above must be in hand."""
        if self.heard != self.turn:
            self.violated(f"{self.name}: acts in {self.turn} before it has heard from above")

    def given(self, elements: Elements, senders: tuple[str, ...], what: str) -> Elements:
        if what == "context":
            self.heard = self.turn
        tags, bare = _split(elements)
        self._check(tags, senders, what)
        return bare

    def _check(self, tags: list[Any], senders: tuple[str, ...], what: str) -> None:
        names = [tag[1] for tag in tags]
        if sorted(names) != sorted(senders):
            self.violated(f"{self.name}: {what} came from {names}, expected {sorted(senders)}")
        for _, sender, process, *turn in tags:
            if Turn(*turn) != self.turn:
                self.violated(f"{self.name}: {what} from {sender} are of {Turn(*turn)}, expected {self.turn}")
            right = self.process_of(self.turn.version, sender)
            if process != right:
                self.violated(f"{self.name}: {what} from {sender} are of process {process}, expected {right}")


def tagged_as_of(elements: Elements, epoch: int, attempt: int) -> Elements:
    tags, bare = _split(elements)
    return (*((*tag[:4], epoch, attempt) for tag in tags), *bare)


def _split(elements: Elements) -> tuple[list[Any], Elements]:
    tags, bare = [], []
    for element in elements:
        if type(element) is tuple and element and type(element[0]) is str and element[0] == _MARK:
            tags.append(element)
        else:
            bare.append(element)
    return tags, tuple(bare)


class Inspected(BoundNode):
    """A bound node whose inputs are looked at."""

    __slots__ = ()

    def __init__(
        self,
        bound: BoundNode,  # the node
        inspector: Inspector,  # of its process
        version: int,  # of the roster that it is bound for
        tasking: tuple[str, ...],  # the nodes above that give it tasks
        act: Callable[[int, Elements], None],  # in the place of the world's, where it has one
    ) -> None:
        name = self.name = bound.name
        self.node, self.below, self.above = bound.node, bound.below, bound.above
        self.initial_belief, self.policies = bound.initial_belief, bound.policies
        self._may_be_none = None

        def observe(epoch: int, time_s: float, observations: Elements, belief: Value) -> Value:
            return bound.observe(epoch, time_s, inspector.observed(observations, bound.below, version, epoch), belief)

        def select_policy(epoch: int, time_s: float, tasks: Elements) -> Value:
            return bound.select_policy(epoch, time_s, inspector.given(tasks, tasking, "tasks"))

        def predict(epoch: int, time_s: float, context: Elements, actions: Elements, belief: Value) -> Value:
            bare = inspector.given(context, bound.above, "context")
            return bound.predict(epoch, time_s, bare, actions, belief)

        self.observe = Through(name, "observe", observe, inspector)
        self.select_policy = Through(name, "select_policy", select_policy, inspector)
        self.predict = Through(name, "predict", predict, inspector)
        acts = lambda epoch, _, actions: act(epoch, actions)  # noqa: E731
        self.act = None if bound.act is None else Through(name, "act", acts, inspector)


class Through(Call):
    """A call that goes through something else, of which the inspector is told."""

    __slots__ = ("_inspector", "_through")

    def __init__(self, subject: str, operator: str, through: Callable[..., Any], inspector: Inspector) -> None:
        self.subject, self.operator = subject, operator
        self._through, self._inspector = through, inspector

    def __call__(self, epoch: int, time_s: float, *arguments: Value) -> Any:
        self._inspector.calls(self, epoch)
        return self._through(epoch, time_s, *arguments)

    def elements(self, epoch: int, time_s: float, argument: Value) -> Elements:
        given: Elements = self(epoch, time_s, argument)
        return given


def inspected_edges(edges: Mapping[tuple[str, str], BoundEdge], name: str, inspector: Inspector) -> list[BoundEdge]:
    """A node's edges, with tags put on what its side gives; of a function that is not there, the empty set."""

    def tagged(call: Call | None, edge: BoundEdge, kind: str) -> Call:
        def give(epoch: int, time_s: float, argument: Value) -> Elements:
            return inspector.tag(() if call is None else call.elements(epoch, time_s, argument))

        return Through(f"{edge.lower}->{edge.upper}", kind, give, inspector)

    return [
        BoundEdge(lower, upper, tagged(edge.sense, edge, "sense"), None, None)
        if lower == name
        else BoundEdge(
            lower,
            upper,
            None,
            None if edge.task is None else tagged(edge.task, edge, "task"),
            tagged(edge.context, edge, "context"),
        )
        for (lower, upper), edge in edges.items()
    ]


def forged(kind: str, message: Message) -> list[Message]:
    """All messages of a kind that can be made of one; what is foretold is what will be said, and something else.

    They come after it, as nobody can tell which of two was the sender's."""
    header = message.header
    if kind == FORETELL:
        attempt = header.attempt + 1
        said = tagged_as_of(message.payload, header.epoch, attempt)
        return [Message(header._replace(attempt=attempt), payload) for payload in (said, (*said, "forged"))]
    if kind == CONTRADICT:
        headers = [header]
    elif header.kind == OBSERVATIONS:
        headers = [
            header._replace(sender="stranger"),
            header._replace(roster=header.roster + ROSTERS_AHEAD + 10),
            header._replace(epoch=header.epoch + EPOCHS_AHEAD + 10),
            header._replace(attempt=header.attempt + ATTEMPTS_AHEAD + 10),
        ]
    else:
        headers = [
            header._replace(receiver="stranger"),
            header._replace(roster=header.roster + ROSTERS_AHEAD + 10),
            header._replace(instance=header.instance + 1000),
            header._replace(kind=CONTEXT, attempt=header.attempt + 1, digest=b""),
        ]
    return [Message(each, (*message.payload, "forged")) for each in headers]
