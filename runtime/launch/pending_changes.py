"""The changes of a launch's roster that were asked for, and what became of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import anyio

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.schemas.control import Propose, encode_control
from hierax.schemas.values import Value

REMEMBERED = 1024  # of how many changes it is remembered what became of them


@dataclass
class PendingChange:
    """A change that was asked for."""

    terms: Mapping[str, ProcessTerms]  # what is done when the processes of its new nodes end
    proposal: bytes  # what the owner is told
    told: Callable[[Mapping[str, Value]], None]  # told once what became of it
    done: anyio.Event = field(default_factory=anyio.Event)  # set when the owner has answered
    answer: dict[str, Value] = field(default_factory=dict)  # what became of it, as a reply


class PendingChanges:
    """Keeps changes by request: those that the owner has not answered yet, and the last ones that it has."""

    def __init__(self) -> None:
        self._changes: dict[str, PendingChange] = {}

    @property
    def unanswered(self) -> list[PendingChange]:
        return [change for change in self._changes.values() if not change.done.is_set()]

    @property
    def proposals(self) -> Sequence[bytes]:
        return [change.proposal for change in self.unanswered]

    @property
    def coming(self) -> Mapping[str, Mapping[str, ProcessTerms]]:
        """The terms of the new nodes of those that were not answered yet."""
        return {request: change.terms for request, change in self._changes.items() if not change.done.is_set()}

    def add(
        self,
        proposal: Propose,
        terms: Mapping[str, ProcessTerms],
        told: Callable[[Mapping[str, Value]], None] = lambda answer: None,
    ) -> None:
        answered = [request for request, change in self._changes.items() if change.done.is_set()]
        for request in answered[: max(len(answered) - REMEMBERED, 0)]:
            del self._changes[request]
        self._changes[proposal.request] = PendingChange(terms, encode_control(proposal), told)

    def terms(self, request: str) -> Mapping[str, ProcessTerms]:
        change = self._changes.get(request)
        return {} if change is None else change.terms

    def in_force(self, request: str) -> bool:
        """Whether a change was made, or was answered so long ago that nobody knows."""
        change = self._changes.get(request)
        return change is None or "epoch" in change.answer

    def answer(self, request: str, epoch: int, refusal: str) -> Mapping[str, ProcessTerms] | None:
        """Take in the first epoch under a change, or a refusal; its new nodes' terms, or None: nobody waits."""
        change = self._changes.get(request)
        if change is None or change.done.is_set():
            return None
        change.answer = {"refusal": refusal} if refusal else {"epoch": epoch}
        change.done.set()
        change.told(change.answer)
        return change.terms

    async def wait(self, request: str) -> Value:
        """The answer to a change, once there is one. Raises `HieraxError` if there is no such change."""
        change = self._changes.get(request)
        if change is None:
            raise HieraxError(f"this launch knows of no change {request!r}")
        await change.done.wait()
        return change.answer
