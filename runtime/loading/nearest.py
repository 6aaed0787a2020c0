"""The nearest valid name, for errors about a wrong one."""

from collections.abc import Iterable
from difflib import get_close_matches

SHOWN = 8  # how many valid names an error lists where none is near


def did_you_mean(wrong: str, valid: Iterable[str], what: str = "expected one of") -> str:
    """The end of an error about a name that is not valid: "; did you mean 'x'?", or after `what` some valid names."""
    names = sorted(set(valid))
    if not names:
        return ""
    near = nearest_of(wrong, names)
    if near:
        return f"; did you mean {near!r}?"
    shown = ", ".join(names[:SHOWN])
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"; {what} {shown}{more}"


def nearest_of(wrong: str, valid: Iterable[str]) -> str:
    """The valid name that is near a wrong one, be its case another one; empty where none is."""
    names = sorted(set(valid))
    lower = {name.lower(): name for name in names}
    near = get_close_matches(wrong, names, n=1) or get_close_matches(wrong.lower(), list(lower), n=1)
    return lower.get(near[0], near[0]) if near else ""
