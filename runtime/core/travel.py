"""Who is to blame for a value that cannot travel: the operator or edge function that made it."""

from __future__ import annotations

from hierax.runtime.core.binding import Call
from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import OperatorError
from hierax.runtime.core.process import ActiveNode
from hierax.schemas.errors import SchemaError
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS
from hierax.schemas.values import encode_value

_FUNCTIONS = {OBSERVATIONS: "sense", TASKS: "task", CONTEXT: "context"}


def cannot_travel(name: str, epoch: int, sensed: Value, state: ActiveNode, error: SchemaError) -> OperatorError:
    """Whose fault it is that a node's state cannot be encoded; `sensed` was its belief after `observe`."""
    made = (
        ("observe", "its belief", sensed),
        (f"policy {state.policy}", "its actions", state.actions),
        ("predict", "its belief", state.belief),
    )
    for operator, what, value in made:
        flaw = _flaw(value)
        if flaw:
            return OperatorError(name, operator, epoch, f"{what}: {flaw}")
    return OperatorError(name, "predict", epoch, f"its belief and actions: {error}")  # too much together


def elements_cannot_travel(kind: str, sender: str, receiver: str, epoch: int, error: SchemaError) -> OperatorError:
    """Whose fault it is that a message cannot be encoded."""
    lower, upper = (sender, receiver) if kind == OBSERVATIONS else (receiver, sender)
    what = f"its elements for {receiver}: {error}"
    return OperatorError(f"{lower}->{upper}", _FUNCTIONS[kind], epoch, what)


def travels(call: Call, epoch: int, what: str, value: Value) -> None:
    """Whether what a call gave can travel. Raises `OperatorError` if it cannot."""
    flaw = _flaw(value)
    if flaw:
        raise OperatorError(call.subject, call.operator, epoch, f"{what}: {flaw}")


def _flaw(value: Value) -> str:
    try:
        encode_value(value)
    except SchemaError as error:
        return str(error)
    return ""
