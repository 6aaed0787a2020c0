"""hierax from Python: hierarchies of classes and functions, run in this process or launched, epoch by epoch.

``hierax.Hierarchy`` describes one, ``hierax.run`` and ``hierax.launch`` run it, or a deployment file. Nodes are written
with what `hierax.runtime` has."""

TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any

    from hierax.runtime.scripting.hierarchy import Hierarchy
    from hierax.runtime.scripting.runs import Epoch, Run, launch, run

__all__ = ["Epoch", "Hierarchy", "Run", "launch", "run"]

_HOMES = {
    "Hierarchy": "hierax.runtime.scripting.hierarchy",
    **dict.fromkeys(("Epoch", "Run", "launch", "run"), "hierax.runtime.scripting.runs"),
}


def __getattr__(name: str) -> "Any":
    """Imported when first asked for, as `hierax.runtime` does: every command comes through here."""
    from hierax.runtime import brought_home

    return brought_home(globals(), _HOMES, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
