"""What can be wrong with a network or with evidence."""

from hierax.runtime.core.errors import HieraxError

Name = str | int  # a node's id


class NetworkError(HieraxError, ValueError):
    """A description is no causal tree or polytree; `node` is whose entry is wrong, if it is one node's."""

    def __init__(self, what: str, node: Name | None = None) -> None:
        self.node = node
        super().__init__(what if node is None else f"node {node!r}: {what}")


class EvidenceError(HieraxError, ValueError):
    """Evidence for `node` that is none: there is no such node, or it is of a wrong length, or no likelihoods."""

    def __init__(self, what: str, node: object) -> None:
        self.node = node
        super().__init__(f"evidence for {node!r}: {what}")


class ImpossibleEvidence(HieraxError):  # noqa: N818 - the name says what the caller has to do with
    """The evidence has probability 0: there is nothing to normalise. It shows at `node`, of which no state agrees with
    all that is known below it."""

    def __init__(self, node: Name) -> None:
        self.node = node
        super().__init__(f"the evidence is impossible: it leaves no state of node {node!r}")
