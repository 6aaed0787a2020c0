"""What a run has come to, and values as plain JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from hierax.runtime.core.elements import Elements, Value
from hierax.schemas.arrays import array_elements

SMALL_ARRAY = 64  # arrays of so many elements are given whole
SMALL_BYTES = 64  # so many bytes are given whole

HEAD_BYTES = 16

Json = Any  # none, a bool, int, finite float, str, list of these or dict from str to these


def plain(value: Value, full: bool = False) -> Json:
    """A value as plain JSON; `full`: also large arrays and long bytes. Raises `TypeError` if it is no value.

    Bytes become hexadecimal text, arrays nested lists, a complex number [real, imaginary]. JSON has no NaN and no
    infinities: they become the strings "NaN", "Infinity" and "-Infinity".

    Of an array of more than `SMALL_ARRAY` elements it is told what it is like, and by which digest it is known:
    ``{"array": {"dtype", "shape", "blake2b", "min", "max", "mean"}}``. The digest is BLAKE2b-256 of its elements as
    messages carry them: in C order, little-endian. The last three lack where it has no finite elements. Bytes of more
    than `SMALL_BYTES` become ``{"bytes": {"size", "head", "blake2b"}}``."""
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, complex):
        return [_number(value.real), _number(value.imag)]
    if isinstance(value, (bytes, bytearray, memoryview)):
        given = bytes(value)
        if full or len(given) <= SMALL_BYTES:
            return given.hex()
        return {"bytes": {"size": len(given), "head": given[:HEAD_BYTES].hex(), "blake2b": _digest(given)}}
    if isinstance(value, dict):
        return {str(key): plain(item, full) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item, full) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, np.ndarray):
        if full or value.size <= SMALL_ARRAY:
            simple = value.dtype.kind in "biu" or (value.dtype.kind == "f" and bool(np.isfinite(value).all()))
            return value.tolist() if simple else plain(value.tolist())
        about = {"dtype": str(value.dtype), "shape": list(value.shape), "blake2b": _digest(array_elements(value))}
        return {"array": {**about, **statistics(value)}}
    raise TypeError(f"a {type(value).__name__} is no value")


def statistics(array: np.ndarray[Any, Any]) -> dict[str, Json]:
    """Least, greatest and mean of an array's finite elements, and how many are not; nothing where none is finite."""
    numbers = np.abs(array) if array.dtype.kind == "c" else array
    finite = numbers[np.isfinite(numbers)]
    if not finite.size:
        return {}
    about: dict[str, Json] = {"min": finite.min().item(), "max": finite.max().item()}
    about["mean"] = _number(float(finite.mean(dtype=np.float64)))
    if finite.size < numbers.size:
        about["not_finite"] = int(numbers.size - finite.size)
    return about


def _digest(data: bytes | memoryview) -> str:
    return blake2b(data, digest_size=32).hexdigest()


def _number(number: float) -> float | str:
    if math.isfinite(number):
        return float(number)
    return "NaN" if math.isnan(number) else "Infinity" if number > 0 else "-Infinity"


@dataclass(frozen=True)
class NodeReport:
    """A node after the last epoch."""

    belief: Value  # its state
    policy: str  # likewise
    actions: Elements  # likewise
    metrics: Mapping[str, float]  # figures that it reports of its belief, by name

    def plain(self) -> Json:
        return {name: plain(value) for name, value in vars(self).items()}


@dataclass(frozen=True)
class Report:
    """A run after its last epoch."""

    hierarchy: str  # its name
    mode: str  # ``run``, ``launch`` or ``replay``
    seed: int  # of all random numbers
    epochs: int  # how many were committed
    digest: str  # of the last epoch, hexadecimal
    wall_s: float  # from the beginning of the first epoch to the commit of the last, in seconds
    epochs_s: Sequence[float] = field(repr=False)  # how long each epoch took, in seconds
    nodes: Mapping[str, NodeReport]  # by name
    output: Path | None = None  # the folder that states and results were written to, or None
    start_s: float | None = None  # from the start of the processes to the first epoch, in seconds; None in one process
    interrupted: bool = False  # whether the run was broken off by a signal; then all is of the last epoch committed
    unreported: Mapping[str, str] = field(default_factory=dict)  # the nodes whose state is not told then, and why
    timing: Json = None  # as `timing.timing_of` gives it; None: nothing was held to a time

    @property
    def epochs_per_s(self) -> float | None:
        """The mean rate; None where there was no epoch."""
        return self.epochs / self.wall_s if self.wall_s > 0 else None

    @property
    def epoch_us(self) -> dict[str, float | None]:
        """The median and the 99th percentile of an epoch's time, in microseconds; None where there was no epoch."""
        times_us = 1e6 * np.array(self.epochs_s)
        return {f"p{share}": float(np.percentile(times_us, share)) if times_us.size else None for share in (50, 99)}

    def plain(self) -> Json:
        """Give it as plain JSON; what only a run that was broken off has to say stands in no other."""
        broken: Json = {"interrupted": True, "unreported": sorted(self.unreported)} if self.interrupted else {}
        return {
            "hierarchy": self.hierarchy,
            "mode": self.mode,
            "epochs": self.epochs,
            "seed": self.seed,
            "digest": self.digest,
            "wall_s": self.wall_s,
            "epoch_us": self.epoch_us,
            "nodes": {name: self.nodes[name].plain() for name in sorted(self.nodes)},
            **broken,
            **({} if self.timing is None else {"timing": self.timing}),
        }


class Interrupted(KeyboardInterrupt):
    """A run was broken off by a signal."""

    def __init__(self, report: Report, unreported: Mapping[str, str]) -> None:
        self.report = replace(report, interrupted=True, unreported=unreported)  # what was committed until then
        super().__init__("the run was broken off by a signal")
