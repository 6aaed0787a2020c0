"""Orders of a launch on another machine: what of them counts here, and what is decided on this machine alone.

Whoever answers at an endpoint says what is to be started. So of an order no more is taken over than what the run is and
how its epochs go; what runs, and all that touches this machine, comes from what its user has named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.launch.frames import NEWCOMER, NodeOrder
from hierax.runtime.loading.allowance import Allowance, module_of
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import check_name
from hierax.schemas.roster import Reference
from hierax.schemas.values import Value


@dataclass(frozen=True)
class AttachedHere:
    """What the user of this machine has named."""

    nodes: Mapping[str, Reference]  # which are asked for
    allowance: Allowance  # which code may be loaded
    trusts: bool  # whether what the launch allows may be loaded, too
    import_paths: Sequence[str]  # where modules are looked for
    endpoint: str  # of the launch
    host: str  # this machine's address for the others; empty: the launch is on this machine
    settings: Value  # Zenoh's own


def read_orders(orders: Value, request: str, here: AttachedHere, folder: Path) -> list[NodeOrder]:
    """The orders for this machine, where the checkpoints are in a folder that was made for this alone.

    Raises `NotAllowedError` if a node's class may not be loaded here, and `HieraxError` if they are no orders, or not
    of the nodes that were asked for.
    """
    if not isinstance(orders, (list, tuple)) or not all(isinstance(order, dict) for order in orders):
        raise HieraxError(f"the launch at {here.endpoint} gave no orders, but {shown(orders)}")
    names = [order.get("name") for order in orders]
    if sorted(map(str, names)) != sorted(here.nodes):
        asked = ", ".join(map(repr, sorted(here.nodes)))
        raise HieraxError(f"the launch at {here.endpoint} orders processes of {shown(names)}; asked for were {asked}")
    return [_local(order, request, here, folder) for order in orders]


def _local(order: Mapping[str, Any], request: str, here: AttachedHere, folder: Path) -> NodeOrder:
    name: str = order["name"]
    reference = here.nodes[name]
    allowance = here.allowance
    if here.trusts:
        allowance = allowance.with_modules(map(str, _field(order, "modules", list, tuple)))
    allowance.check(reference.target, f"nodes.{name}.class")
    return NodeOrder(
        name=name,
        process=_name(order, "process"),
        life=NEWCOMER,
        request=request,
        deployment=_name(order, "deployment"),
        run=_name(order, "run"),
        modules=allowance.modules,
        preload=(module_of(reference.target),),
        seed=_field(order, "seed", int),
        epochs=_field(order, "epochs", int, type(None)),
        staleness=_field(order, "staleness", int, type(None)),
        exact=_field(order, "exact", bool),
        rate_hz=_field(order, "rate_hz", float, int, type(None)),
        hub=here.endpoint,
        host=here.host,
        settings=here.settings,
        low_latency=_field(order, "low_latency", bool),
        import_paths=tuple(here.import_paths),
        checkpoint=str(folder / name),
        durability="host" if order.get("durability") == "host" else "process",
        recorded=_field(order, "recorded", bool),
        elsewhere=True,
    )


def _field(order: Mapping[str, Any], field: str, *kinds: type) -> Any:
    value = order.get(field)
    if type(value) not in kinds:
        expected = " or ".join(kind.__name__ for kind in kinds)
        raise HieraxError(f"{order['name']}: the launch's order says {field}: {shown(value)}; expected {expected}")
    return value


def _name(order: Mapping[str, Any], field: str) -> str:
    try:
        return check_name(order.get(field), field)  # type: ignore[arg-type]
    except SchemaError as error:
        raise HieraxError(f"{order['name']}: the launch's order says {field}: {error}") from error
