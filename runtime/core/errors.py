"""Errors of the core, each saying whose fault it is."""


class HieraxError(Exception):
    """Base of the errors that a user can cause and mend: one clear line each."""


FAILURES = (Exception, SystemExit)
"""What is caught of code that a user wrote. Code that exits has failed as well: it would end all nodes, in silence."""


class PlacedError(HieraxError):
    """`what` is wrong, and `where`, as a path in the roster and in the deployment file."""

    def __init__(self, what: str, where: str) -> None:
        self.what = what
        self.where = where
        super().__init__(f"{where}: {what}")


class HierarchyError(HieraxError):
    """Nodes and edges do not form a cognitive hierarchy (definition 2)."""


class ProbeError(HieraxError):
    """A probe raised; the cause is chained."""

    def __init__(self, subject: str, probe: object, operation: str, error: BaseException) -> None:
        what = f"{type(error).__name__}: {error}"
        super().__init__(f"{subject}: {operation} of its probe {type(probe).__name__}: {what}")


class OperatorError(HieraxError):
    """An operator or edge function raised, or returned what it must not.

    Attributes:
        subject: the node, or the edge as ``lower->upper``.
        operator: which one.
        epoch: in which epoch; 0 before the first.
    """

    def __init__(self, subject: str, operator: str, epoch: int, what: str) -> None:
        self.subject = subject
        self.operator = operator
        self.epoch = epoch
        super().__init__(f"{subject}: {operator} in epoch {epoch}: {what}")


class ContradictionError(HieraxError):
    """Two messages of one sender, kind, epoch, attempt, roster and instance differ: one of them is forged."""
