"""The runtime: what turns nodes and a deployment file into a running hierarchy."""

TYPE_CHECKING = False
"""As `typing` has it, which takes its time: nothing is to stand before the console script."""

if TYPE_CHECKING:
    from typing import Any

    from hierax.runtime.core.elements import Elements, Value
    from hierax.runtime.core.node import NO_TICK, Node, Tick, World
    from hierax.runtime.core.probe import Probe, Step

__all__ = ["NO_TICK", "Elements", "Node", "Probe", "Step", "Tick", "Value", "World"]

_HOMES = {
    **dict.fromkeys(("Elements", "Value"), "hierax.runtime.core.elements"),
    **dict.fromkeys(("NO_TICK", "Node", "Tick", "World"), "hierax.runtime.core.node"),
    **dict.fromkeys(("Probe", "Step"), "hierax.runtime.core.probe"),
}


def __getattr__(name: str) -> "Any":
    """Imported when first asked for: numpy takes a tenth of a second, and every pytest loads the plugin below."""
    return brought_home(globals(), _HOMES, name)


def brought_home(package: "dict[str, Any]", homes: dict[str, str], name: str) -> "Any":
    """What a package offers under a name, imported from its home and kept among the package's globals."""
    if name not in homes:
        raise AttributeError(f"module {package['__name__']!r} has no attribute {name!r}")
    from importlib import import_module

    package[name] = getattr(import_module(homes[name]), name)
    return package[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
