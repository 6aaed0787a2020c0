"""What a recording says of itself: the run, where it was recorded, and how it ended."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.core.staleness import Staleness
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.secrets import public_settings, public_text
from hierax.runtime.host.private_files import errors_named
from hierax.runtime.host.seal import RECORDING, is_sealed, seal_or_warn
from hierax.schemas.errors import SchemaError, shown
from hierax.schemas.keys import check_name

FORMAT = 2
READ = (1, FORMAT)
"""What this version reads; the first format has neither modules nor a seal."""

_PACKAGES = ("hierax", "numpy", "opencv-python-headless", "eclipse-zenoh", "msgpack", "mcap", "pybullet")


class RecordingError(HieraxError):
    """A recording cannot be written, read or used."""


@dataclass(frozen=True)
class RunInfo:
    """What is recorded.

    Attributes:
        hierarchy, run, mode, seed: the hierarchy's name, the run's identification, ``launch`` or ``run``, and its seed.
        staleness, exact: as the deployment has them.
        deployment, deployment_text: path of the deployment file, and what it said, but for what is secret.
        settings: with which it was read; of secret ones the paths alone.
        import_paths: where the deployment's own modules were looked for.
        from_start: whether the recording begins with the run.
        left_out: patterns of the keys that are not recorded, as `hierax.runtime.recording.selection` has them.
        started_ns: when it began, since 1970.
        machine, versions: what it was recorded on; the versions of hierax and what it uses.
        format: of the recording.
        modules: from which code may be loaded, as `hierax.runtime.loading.allowance.Allowance` has them.
        seal: of all that, by the user who has recorded it; empty: there is none.
    """

    hierarchy: str
    run: str
    mode: str
    seed: int
    staleness: int | None
    exact: bool
    deployment: str
    deployment_text: str
    settings: Sequence[str]
    import_paths: Sequence[str]
    from_start: bool
    left_out: Sequence[str] = ()
    started_ns: int = field(default_factory=time.time_ns)
    machine: Mapping[str, Any] = field(default_factory=lambda: _machine())
    versions: Mapping[str, str] = field(default_factory=lambda: _versions())
    format: int = FORMAT
    modules: Sequence[str] = ()
    seal: str = ""

    @staticmethod
    def of(
        deployment: Deployment, run: str, mode: str, seed: int, settings: Sequence[str], from_start: bool
    ) -> RunInfo:
        """What is recorded of a run of a deployment."""
        info = RunInfo(
            deployment.name,
            run,
            mode,
            seed,
            deployment.staleness.epochs,
            deployment.staleness.exact,
            str(deployment.path.resolve()),
            public_text(_text(deployment), deployment.zenoh),
            public_settings(settings, deployment.zenoh),
            deployment.import_paths,
            from_start,
            modules=deployment.modules,
        )
        return replace(info, seal=seal_or_warn(RECORDING, info._sealed))

    @property
    def is_ours(self) -> bool:
        """Whether this user has recorded it on this machine, and nobody has changed what it says of the run."""
        return is_sealed(RECORDING, self._sealed, self.seal)

    @property
    def _sealed(self) -> dict[str, Any]:
        # what is left out is known to the recorder alone, and names no code
        return {name: value for name, value in self.plain().items() if name not in ("seal", "left_out")}

    @property
    def how_stale(self) -> Staleness:
        """How old inputs from above may be."""
        return Staleness(self.staleness, self.exact)

    def plain(self) -> dict[str, Any]:
        """Give it as a value."""
        return asdict(self)

    @staticmethod
    def read(plain: Mapping[str, Any]) -> RunInfo:
        """Read it from a value, but for later fields. Raises `RecordingError` if its format or a field is wrong."""
        if plain.get("format") not in READ:
            read = " and ".join(map(str, READ))
            raise RecordingError(f"format {plain.get('format')!r:.20}; this version reads formats {read}")
        given = {each.name: plain[each.name] for each in fields(RunInfo) if each.name in plain}
        lacking = [name for name in _FIELDS if name not in given and (plain["format"] == FORMAT or name not in _NEW)]
        if lacking:
            raise RecordingError(f"it says too little of its run: {', '.join(lacking)}")
        for name, value in given.items():
            expected, is_such = _FIELDS[name]
            if not is_such(value):
                raise RecordingError(f"{name}: expected {expected}, got {shown(value)}")
        return RunInfo(**given)


@dataclass(frozen=True)
class Gap:
    """So many things (a node's messages or steps, in words) that were said in an epoch and are not in the recording."""

    epoch: int
    what: str
    count: int = 1

    def __str__(self) -> str:
        return f"epoch {self.epoch}: {self.what}"


@dataclass(frozen=True)
class Ending:
    """How a recording ended; it lacks where the recorder was killed.

    Attributes:
        first, last: the epochs that were committed meanwhile; 0: none.
        messages: how many things were heard.
        gaps: what lacks, the first ones.
        lost: how many things lack in all.
        cut_short: messages that lack as their senders' processes died while they were sent; no fault of the recorder's.
        cut: by which option it ends before the run; empty: by none.
        left_out: how much came on keys that are left out, by their pattern.
    """

    first: int
    last: int
    messages: int
    gaps: tuple[Gap, ...]
    lost: int
    cut_short: tuple[Gap, ...] = ()
    cut: str = ""
    left_out: Mapping[str, int] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """Give it as a value."""
        return asdict(self)

    @staticmethod
    def read(plain: Mapping[str, Any]) -> Ending:
        """Read it from a value. Raises `RecordingError` if a field lacks or is something else."""
        unreadable = "what it says of its end cannot be read"
        try:
            given = {each.name: plain[each.name] for each in fields(Ending) if each.name in plain}
            gaps = {name: tuple(Gap(**gap) for gap in given.get(name, ())) for name in ("gaps", "cut_short")}
            ending = Ending(**{**given, **gaps, "left_out": dict(given.get("left_out", {}))})
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{unreadable}: {error}") from error
        told = [*ending.gaps, *ending.cut_short]
        numbers = [ending.first, ending.last, ending.messages, ending.lost]
        numbers += [number for gap in told for number in (gap.epoch, gap.count)]
        if not all(map(_is_whole, numbers)) or not all(isinstance(gap.what, str) for gap in told):
            raise RecordingError(f"{unreadable}: expected whole numbers from 0, and texts")
        if not all(map(_is_text, (ending.cut, *ending.left_out))):
            raise RecordingError(f"{unreadable}: expected texts for what is left out")
        if not all(map(_is_whole, ending.left_out.values())):
            raise RecordingError(f"{unreadable}: expected how much is left out")
        return ending


def to_metadata(plain: Mapping[str, Any]) -> dict[str, str]:
    """A map as metadata of the file: text as it is, everything else as JSON."""
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in plain.items()}


def from_metadata(metadata: Mapping[str, str], texts: Sequence[str] = ()) -> dict[str, Any]:
    """The map that metadata was made from, where some values are texts; `RecordingError` if it is none."""
    try:
        return {name: text if name in texts else json.loads(text) for name, text in metadata.items()}
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"its metadata is not what hierax writes: {error!s:.200}") from error


_LARGEST = 2**63 - 1
INFO_TEXTS = tuple(each.name for each in fields(RunInfo) if each.type == "str")
ENDING_TEXTS = ("cut",)


def _is_whole(value: object) -> bool:
    return type(value) is int and 0 <= value <= _LARGEST


def _is_text(value: object) -> bool:
    """Text that a path may be, and that can be written."""
    return isinstance(value, str) and "\x00" not in value and not any("\ud800" <= char <= "\udfff" for char in value)


def _is_name(value: object) -> bool:
    try:
        return bool(check_name(value))  # type: ignore[arg-type]
    except SchemaError:
        return False


Expected = tuple[str, Callable[[object], bool]]
_BY_TYPE: dict[object, Expected] = {
    "str": ("text", _is_text),
    "int": ("a whole number from 0", _is_whole),
    "int | None": ("a whole number from 0, or null", lambda value: value is None or _is_whole(value)),
    "bool": ("true or false", lambda value: isinstance(value, bool)),
    "Sequence[str]": ("a list of texts", lambda value: isinstance(value, (list, tuple)) and all(map(_is_text, value))),
    "Mapping[str, str]": (
        "a map of texts",
        lambda value: isinstance(value, Mapping) and all(map(_is_text, [*value, *value.values()])),
    ),
    "Mapping[str, Any]": ("a map", lambda value: isinstance(value, Mapping)),
}
_NAME: Expected = ("a name", _is_name)
_FIELDS: dict[str, Expected] = {
    **{each.name: _BY_TYPE[each.type] for each in fields(RunInfo)},
    "hierarchy": _NAME,
    "run": _NAME,
}
"""What each field of `RunInfo` has to be."""

_NEW = ("modules", "seal", "left_out")
"""Fields that the first format lacks."""


def _text(deployment: Deployment) -> str:
    with errors_named(deployment.path, "read", RecordingError):
        return deployment.path.read_text(encoding="utf-8-sig")


def _machine() -> dict[str, Any]:
    return {
        "host": platform.node(),
        "system": platform.platform(),
        "processor": platform.machine(),
        "processors": os.cpu_count(),
        "python": sys.version.split()[0],
    }


def _versions() -> dict[str, str]:
    found = {}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
