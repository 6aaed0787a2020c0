"""What a recording says of itself: the run, where it was recorded, and how it ended."""

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
from hierax.runtime.host.run_folder import RECORDING, is_sealed, seal_or_warn
from hierax.schemas.errors import shown
from hierax.schemas.keys import is_name
from hierax.schemas.limits import LARGEST

FORMAT = 3
READ = (1, 2, FORMAT)  # what this version reads; the first has neither modules nor a seal, both say more of a staleness
_PACKAGES = ("hierax", "numpy", "opencv-python-headless", "eclipse-zenoh", "msgpack", "mcap", "pybullet")


class RecordingError(HieraxError):
    """A recording cannot be written, read or used."""


@dataclass(frozen=True)
class RunInfo:
    """What is recorded."""

    hierarchy: str  # its name
    run: str  # its identification
    mode: str  # ``launch`` or ``run``
    seed: int
    staleness: int | None  # as the deployment has it
    deployment: str  # the path of its file
    deployment_text: str  # what that said, but for what is secret
    settings: Sequence[str]  # with which it was read; of secret ones the paths alone
    import_paths: Sequence[str]  # where the deployment's own modules were looked for
    from_start: bool  # whether the recording begins with the run
    left_out: Sequence[str] = ()  # patterns of the keys that are not recorded, as `Selection` has them
    started_ns: int = field(default_factory=time.time_ns)  # when it began, since 1970
    machine: Mapping[str, Any] = field(default_factory=lambda: _machine())
    versions: Mapping[str, str] = field(default_factory=lambda: _versions())  # of hierax and what it uses
    format: int = FORMAT  # of the recording
    modules: Sequence[str] = ()  # from which code may be loaded, as `Allowance` has them
    seal: str = ""  # of all that, by the user who has recorded it; empty: there is none

    @staticmethod
    def of(
        deployment: Deployment, run: str, mode: str, seed: int, settings: Sequence[str], from_start: bool
    ) -> "RunInfo":
        """What is recorded of a run of a deployment."""
        with errors_named(deployment.path, "read", RecordingError):
            text = public_text(deployment.path.read_text(encoding="utf-8-sig"), deployment.zenoh)
        info = RunInfo(
            *(deployment.name, run, mode, seed, deployment.staleness.epochs),
            *(str(deployment.path.resolve()), text, public_settings(settings, deployment.zenoh)),
            *(deployment.import_paths, from_start),
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
        return Staleness(self.staleness)

    def plain(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def read(plain: Mapping[str, Any]) -> "RunInfo":
        """Read it from a value, but for later fields. Raises `RecordingError` if its format or a field is wrong."""
        if plain.get("format") not in READ:
            raise RecordingError(f"format {plain.get('format')!r:.20}; this version reads formats 1 to {FORMAT}")
        wanted = [each.name for each in fields(RunInfo) if plain["format"] > 1 or each.name not in _NEW]
        lacking = [name for name in wanted if name not in plain]
        if lacking:
            raise RecordingError(f"it says too little of its run: {', '.join(lacking)}")
        return RunInfo(**_checked(RunInfo, plain, hierarchy=_NAME, run=_NAME))


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
    """How a recording ended; it lacks where the recorder was killed."""

    first: int  # of the epochs that were committed meanwhile; 0: none
    last: int  # of them
    messages: int  # how many things were heard
    gaps: tuple[Gap, ...]  # what lacks, the first ones
    lost: int  # how many things lack in all
    cut_short: tuple[Gap, ...] = ()  # messages whose senders' processes died while they were sent
    cut: str = ""  # by which option it ends before the run; empty: by none
    left_out: Mapping[str, int] = field(default_factory=dict)  # how much came on such keys, by their pattern

    def plain(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def read(plain: Mapping[str, Any]) -> "Ending":
        """Read it from a value. Raises `RecordingError` if a field lacks or is something else."""
        try:
            kinds = {name: plain.get(name, ()) for name in ("gaps", "cut_short")}
            gaps = {name: tuple(Gap(**_checked(Gap, gap)) for gap in given) for name, given in kinds.items()}
            return Ending(**{**_checked(Ending, plain), **gaps})
        except (RecordingError, TypeError) as error:
            raise RecordingError(f"what it says of its end cannot be read: {error}") from error


def to_metadata(plain: Mapping[str, Any]) -> dict[str, str]:
    """A map as metadata of the file: text as it is, everything else as JSON."""
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in plain.items()}


def from_metadata(metadata: Mapping[str, str], texts: Sequence[str] = ()) -> dict[str, Any]:
    """The map that metadata was made from, where some values are texts; `RecordingError` if it is none."""
    try:
        return {name: text if name in texts else json.loads(text) for name, text in metadata.items()}
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"its metadata is not what hierax writes: {error!s:.200}") from error


INFO_TEXTS = tuple(each.name for each in fields(RunInfo) if each.type is str)
ENDING_TEXTS = ("cut",)


def _is_whole(value: object) -> bool:
    return type(value) is int and 0 <= value <= LARGEST


def _is_text(value: object) -> bool:
    """Text that a path may be, and that can be written."""
    return isinstance(value, str) and "\x00" not in value and not any("\ud800" <= char <= "\udfff" for char in value)


Expected = tuple[str, Callable[[object], bool]]
_BY_TYPE: dict[object, Expected] = {
    str: ("text", _is_text),
    int: ("a whole number from 0", _is_whole),
    int | None: ("a whole number from 0, or null", lambda value: value is None or _is_whole(value)),
    bool: ("true or false", lambda value: isinstance(value, bool)),
    Sequence[str]: ("a list of texts", lambda value: isinstance(value, (list, tuple)) and all(map(_is_text, value))),
    Mapping[str, str]: (
        "a map of texts",
        lambda value: isinstance(value, Mapping) and all(map(_is_text, [*value, *value.values()])),
    ),
    Mapping[str, int]: (
        "whole numbers from 0 by texts",
        lambda value: isinstance(value, Mapping) and all(map(_is_text, value)) and all(map(_is_whole, value.values())),
    ),
    Mapping[str, Any]: ("a map", lambda value: isinstance(value, Mapping)),
    tuple[Gap, ...]: ("a list of gaps", lambda value: isinstance(value, (list, tuple))),
}
_NAME: Expected = ("a name", is_name)
_NEW = ("modules", "seal", "left_out")  # fields that the first format lacks


def _checked(record: type, plain: Mapping[str, Any], **others: Expected) -> dict[str, Any]:
    """The fields of a record that a map has; `RecordingError` says which one is not what its type, or another, says."""
    given = {each.name: (each.type, plain[each.name]) for each in fields(record) if each.name in plain}
    for name, (kind, value) in given.items():
        expected, is_such = others.get(name) or _BY_TYPE[kind]
        if not is_such(value):
            raise RecordingError(f"{name}: expected {expected}, got {shown(value)}")
    return {name: value for name, (_, value) in given.items()}


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
