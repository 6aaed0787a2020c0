"""Whether what a node answers has the shape of what it was asked for (`hierax.runtime.launch.inspection_server`).

Looked at is what tools make use of. What else is in an answer, and what a node believes, may be anything."""

from collections.abc import Callable, Mapping

import numpy as np

from hierax.runtime.core.probe import Step
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import is_name
from hierax.schemas.roster import Roster
from hierax.schemas.values import Value

Fits = Callable[[Value], bool]

_MOST = 1 << 63  # no figure is larger, so that sums and rates of them are finite


def is_answer(look: str, answer: Mapping[str, Value]) -> bool:
    """Whether an answer has the shape that the question of a name, one of the inspection server's, has it."""
    return _ANSWERS[look](answer)


def is_report(said: Mapping[str, Value]) -> bool:
    """Whether the last word of a node's process has the shape that a run's report is made of."""
    return _REPORT(said)


def _is_anything(value: Value) -> bool:
    return True


def _is_text(value: Value) -> bool:
    return isinstance(value, str)


def _is_whole(value: Value) -> bool:
    return type(value) is int


def _is_count(value: Value) -> bool:
    return type(value) is int and 0 <= value < _MOST


def _is_number(value: Value) -> bool:
    return type(value) in (int, float)


def _is_figure(value: Value) -> bool:
    return type(value) in (int, float) and -_MOST <= value <= _MOST  # so it is finite, too


def _list_of(fits: Fits) -> Fits:
    return lambda value: isinstance(value, (tuple, list)) and all(map(fits, value))


def _map_of(fits: Fits, fits_key: Fits = _is_text) -> Fits:
    return lambda value: isinstance(value, dict) and all(fits_key(key) and fits(each) for key, each in value.items())


def _has(**fields: Fits) -> Fits:
    """A map in which these fields are, and each fits."""

    def fits_all(value: Value) -> bool:
        return isinstance(value, dict) and all(name in value and fits(value[name]) for name, fits in fields.items())

    return fits_all


def _may_have(**fields: Fits) -> Fits:
    """A map in which each of these fields fits that is there."""

    def fits_all(value: Value) -> bool:
        return isinstance(value, dict) and all(fits(value[name]) for name, fits in fields.items() if name in value)

    return fits_all


def _both(first: Fits, second: Fits) -> Fits:
    return lambda value: first(value) and second(value)


def _is_slot(value: Value) -> bool:
    return isinstance(value, (tuple, list)) and len(value) == 2 and all(map(_is_text, value))


def _is_pace(value: Value) -> bool:
    """All of it is printed, so nothing else may be in it."""
    if not _PACE(value):
        return False
    return all(_is_figure(figure) for what, figure in value.items() if what != "epochs")


def _is_state(value: Value) -> bool:
    if "refusal" in value:
        return _is_text(value["refusal"])
    return _STATE(value) and ("sensed" not in value or _STEP(value))


def _is_run(value: Value) -> bool:
    """What a world's process reports: the epochs, the last digest, and the seconds of all and of each."""
    if not isinstance(value, tuple) or len(value) != 4:
        return False
    epochs, digest, wall_s, took_s = value
    is_array = isinstance(took_s, np.ndarray) and took_s.ndim == 1 and took_s.dtype == np.float64
    return _is_count(epochs) and isinstance(digest, bytes) and _is_figure(wall_s) and is_array


def _is_committed(value: Value) -> bool:
    return value is None or isinstance(value, bool)


def _is_roster(value: Value) -> bool:
    if value is None:  # most nodes know none
        return True
    try:
        Roster.read(value)
    except SchemaError:
        return False
    return True


_COUNTS, _NAMES, _ELEMENTS = _list_of(_is_count), _list_of(is_name), _list_of(_is_anything)
_FIGURES = ("period_ms", "p50_ms", "p99_ms", "max_ms", "late", "skipped")
_PACE = _has(epochs=_COUNTS, **dict.fromkeys(_FIGURES, _is_figure))
_TIMING = _may_have(
    pace=_is_pace,
    budget=_has(budget_ms=_is_figure, over=_is_count, max_ms=_is_figure, epochs=_COUNTS),
    overruns=_map_of(_has(count=_is_count, epochs=_COUNTS), is_name),
)
_METER = _has(
    pid=_is_count,
    epoch=_is_count,
    busy=_is_text,
    waits_for=_list_of(_is_slot),
    rss_bytes=_is_count,
    cpu_s=_is_figure,
    metrics=_map_of(_is_number),
    meter=_has(
        ns=_is_count,
        epochs=_is_count,
        work_ns=_map_of(_is_whole),
        waiting_ns=_map_of(_is_whole),
        epochs_ns=_COUNTS,
    ),
)
_STATE = _has(
    epoch=_is_count,
    committed=_is_committed,
    below=_NAMES,
    above=_NAMES,
    policy=_is_text,
    policies=_list_of(_is_text),
    actions=_ELEMENTS,
    belief=_is_anything,
    **{"class": _is_text},
)
_STEP = _has(
    before=_is_anything,
    **dict.fromkeys(Step._fields, _is_anything)
    | {"attempt": _is_count, "time_s": _is_figure}
    | dict.fromkeys(("observations", "tasks", "context"), _ELEMENTS),
)
_REPORT = _both(
    _has(
        epoch=_is_count,
        attempt=_is_count,
        belief=_is_anything,
        policy=_is_text,
        actions=_ELEMENTS,
        metrics=_map_of(_is_anything),
    ),
    _may_have(run=_is_run, timing=_TIMING),
)
_ANSWERS: Mapping[str, Fits] = {
    "meter": _both(_METER, _may_have(in_force=_map_of(_is_count, is_name), timing=_TIMING)),
    "state": _is_state,
    "neighbours": _has(below=_NAMES),
    "echo": _is_anything,
    "steps": _has(roster=_is_roster),
    "roster": _has(roster=_is_roster),
}
