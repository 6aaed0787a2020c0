"""Folders to resume, keys, and what stands where launches are found, made to run code or to reach other files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.host.run_secret import key_text, new_secret
from hierax.runtime.launch.orders import LaunchOptions, Orders
from hierax.runtime.recovery.disk import MappedFile
from hierax.runtime.recovery.slots import Slots
from hierax.schemas.checkpoint import WorldRecord, encode_world
from hierax.schemas.values import decode_value, encode_value
from support.malice import CLAIMS, NOT_OURS, PRECIOUS, Attack, Place, names_code


def _state(place: Place) -> Path:
    """The folder of a run that was begun."""
    state = place.folder / "state"
    state.mkdir(mode=0o700)
    Orders(read_deployment(place.deployment), "5163af85", "", LaunchOptions(3, 9, state)).save()
    return state


def _resumed(spoil: Callable[[Place, Path], object]) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        state = _state(place)
        spoil(place, state)
        return ("launch", "--resume", str(state))

    return made


def _edited(**fields: Any) -> Callable[[Place, Path], object]:
    def spoil(place: Place, state: Path) -> object:
        path = state / "run.json"
        return path.write_text(json.dumps({**json.loads(path.read_text()), **fields}))

    return spoil


def _record(data: Callable[[Place], bytes]) -> Callable[[Place, Path], object]:
    def spoil(place: Place, state: Path) -> object:
        storage = MappedFile(state / "world", "process")
        for _ in range(2):
            Slots(storage).write(data(place))
        return storage.close()

    return spoil


def _world(place: Place, change: Callable[[WorldRecord], WorldRecord]) -> bytes:
    roster = read_deployment(place.deployment).roster
    record = WorldRecord(1, 0, 0, encode_value(roster.plain()), 0, bytes(32), encode_value((0, "", ())))
    return encode_world(change(record))


def _link(name: str, mode: str) -> Callable[[Place, Path], object]:
    def spoil(place: Place, state: Path) -> object:
        path = state / name
        path.unlink(missing_ok=True)
        if mode == "pipe":
            return os.mkfifo(path)
        return path.symlink_to(place.folder / PRECIOUS)

    return spoil


def _locked(place: Place, state: Path) -> object:
    _record(lambda place: _world(place, lambda record: record))(place, state)
    return _link("world.lock", "link")(place, state)


def _huge(place: Place, state: Path) -> None:
    with (state / "world.0").open("wb") as file:
        file.write(b"hieraxC\x01")
        file.truncate(2 << 30)


UPWARDS = encode_value({"left": ("token", 0, 1, "../../precious")})

FOLDERS = {
    "whose deployment is theirs": Attack(_resumed(_edited(deployment="/tmp/theirs.yaml")), NOT_OURS),
    "with settings that name code": Attack(_resumed(_edited(settings=["nodes.left.class=os:system"])), NOT_OURS),
    "without a seal": Attack(_resumed(_edited(seal="")), NOT_OURS),
    "with a seal that is a list": Attack(_resumed(_edited(seal=[])), NOT_OURS),
    "with nested JSON": Attack(_resumed(lambda _, state: (state / "run.json").write_text("[" * 100_000)), "expected"),
    "with 20 MB of JSON": Attack(_resumed(lambda _, state: (state / "run.json").write_bytes(b" " * (20 << 20))), ""),
    "whose checkpoints are called ../..": Attack(
        _resumed(_record(lambda place: _world(place, lambda record: record._replace(processes=UPWARDS)))),
        "expected the identification of the change"),
    "that is a link (run.json)": Attack(_resumed(_link("run.json", "link")), "symbolic link"),
    "with a pipe in place of run.json": Attack(_resumed(_link("run.json", "pipe")), "no regular file"),
    "with a link in place of a checkpoint": Attack(_resumed(_link("world.0", "link")), "symbolic link"),
    "with a pipe in place of a checkpoint": Attack(_resumed(_link("world.0", "pipe")), "no regular file"),
    "with a link in place of a lock": Attack(_resumed(_locked), "symbolic link"),
    "that others may write": Attack(_resumed(lambda _, state: state.chmod(0o777)), "others may write"),
    "with a checkpoint of 2 GiB that are not there": Attack(_resumed(_huge), ""),
    "whose record calls os.system": Attack(
        _resumed(_record(lambda place: _world(
            place, lambda record: record._replace(roster=names_code(place, record.roster))))), "may not be loaded"),
    **{f"whose record is {what}": Attack(_resumed(_record(lambda _, each=each: each)), "")
       for what, each in CLAIMS.items()},
    **{f"whose roster is {what}": Attack(
        _resumed(_record(lambda place, each=each: _torn(place, each))), "") for what, each in CLAIMS.items()},
}  # fmt: skip


def _torn(place: Place, claim: bytes) -> bytes:
    """A record whose roster is something else, unlooked at when it is written."""
    fields = decode_value(_world(place, lambda record: record))
    assert isinstance(fields, (list, tuple))
    return encode_value((*fields[:4], claim, *fields[5:]))


def _keyed(content: str | bytes, mode: int = 0o600) -> Callable[[Place], Sequence[str]]:
    return lambda place: ("ps", "--connect", "tcp/127.0.0.1:9", "--key", str(place.file("a.key", content, mode)))


def _found(text: str) -> Callable[[Place], Sequence[str]]:
    """A file that says that a launch runs here."""

    def made(place: Place) -> Sequence[str]:
        (place.folder / "hierax").mkdir(mode=0o700)
        place.file("hierax/run.json", text)
        return ("ps",)

    return made


def _logged(spoil: Callable[[Place, Path], object]) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        run = Path(os.environ["XDG_STATE_HOME"]) / "hierax" / "runs" / place.folder.name
        (run / "logs").mkdir(mode=0o700, parents=True)
        (run / "about.json").write_text(json.dumps({"run": run.name, "hierarchy": "toys", "pid": 1}))
        spoil(place, run)
        return ("logs", "--run", run.name)

    return made


def _line(**fields: Any) -> str:
    given = {
        "time": "2026-01-01T00:00:00Z",
        "level": "WARNING",
        "logger": "hierax",
        "node": "left",
        "message": "x",
        **fields,
    }
    return json.dumps(given) + "\n"


_DEAD = {"hierarchy": "toys", "endpoint": "tcp/127.0.0.1:9", "pid": 1 << 22, "deployment": "x", "settings": []}
KEYS = {
    "that others may read": Attack(_keyed(key_text(new_secret()), 0o644), "others may read it"),
    "that a group may read": Attack(_keyed(key_text(new_secret()), 0o640), "others may read it"),
    "of 100 MB": Attack(_keyed(b"hierax:" + b"a" * (100 << 20)), "expected the key of a run"),
    "that is no text": Attack(_keyed(b"hierax:" + bytes(range(256))), "expected the key of a run"),
    "whose authority is no certificate": Attack(
        _keyed("hierax:ab12\n" + "".join(
            f"-----BEGIN {each}-----\nAAAA\n-----END {each}-----\n" for each in ("CERTIFICATE", "PRIVATE KEY"))),
        "certificate"),
    "that is a folder": Attack(
        lambda place: ("ps", "--connect", "tcp/127.0.0.1:9", "--key", str(place.folder)), "is a directory", (2,)),
    "a launch called ../precious": Attack(_found(json.dumps({**_DEAD, "run": "../precious"})), "", (0,)),
    "a launch in nested JSON": Attack(_found("[" * 100_000), "", (0,)),
    "a launch of process -1": Attack(_found(json.dumps({**_DEAD, "run": "abc", "pid": -1})), "", (0,)),
    "logs with characters that move the cursor": Attack(
        _logged(lambda _, run: (run / "logs" / "left.jsonl").write_text(_line(message="\x1b[2J\x07"))), "", (0,)),
    "logs in nested JSON": Attack(
        _logged(lambda _, run: (run / "logs" / "left.jsonl").write_text("[" * 100_000 + "\n")), "", (0, 1)),
    "logs that are a link": Attack(
        _logged(lambda place, run: (run / "logs" / "left.jsonl").symlink_to(place.folder / PRECIOUS)), "", (0, 1)),
}  # fmt: skip
