"""Other msgpack libraries read our bytes by following the documented format."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from support.golden import FOLDER, encoded
from support.tagged import tagged

FILES = sorted(FOLDER.glob("*.msgpack"))
NPM_PACKAGE = "@msgpack/msgpack@3.1.2"
KINDS = ("obs", "task", "ctx", "hello")
FIELDS = ("kind", "sender", "receiver", "epoch", "attempt", "roster", "instance", "time_s", "digest", "extensions")


def numeric_array(data: bytes) -> np.ndarray:
    """Extension 1, as its documentation says."""
    ndim, name_length, padding = struct.unpack_from("<BBH", data)
    shape = struct.unpack_from(f"<{ndim}Q", data, 4 + name_length)
    start = 4 + name_length + 8 * ndim + padding
    return np.frombuffer(data[start:], data[4 : 4 + name_length].decode()).reshape(shape)


class TailReference(int):
    """Extension 2: the number of an array behind the payload."""


def extension(code: int, data: bytes) -> Any:
    return {1: numeric_array, 2: lambda data: TailReference(struct.unpack(">H", data)[0])}[code](data)


def resolved(value: Any, tail: list[np.ndarray]) -> Any:
    if isinstance(value, TailReference):
        return tail[value]
    if isinstance(value, dict):
        return {key: resolved(part, tail) for key, part in value.items()}
    if isinstance(value, list):
        return [resolved(part, tail) for part in value]
    return value


def plainly_decoded(name: str, data: bytes) -> Any:
    """A golden file as the plain msgpack library reads it, in the form of the JSON beside it."""
    value = msgpack.unpackb(data, ext_hook=extension)
    if not name.startswith("message-"):
        return tagged(value)
    form, kind, *rest = value[:12]
    tail = value[12:-1]
    assert form == 1
    fields = [resolved(field, tail) for field in rest]
    header = dict(zip(FIELDS, [KINDS[kind], *fields[:-1]], strict=True))
    return {"header": tagged(header), "payload": tagged(fields[-1])}


def expected(path: Path) -> Any:
    return json.loads(path.with_suffix(".json").read_text())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_plain_library_reads_our_bytes(path: Path) -> None:
    assert plainly_decoded(path.name, encoded()[path.name]) == expected(path)


def test_the_tail_says_how_long_it_is() -> None:
    data = encoded()["message-large-arrays.msgpack"]
    fields = msgpack.unpackb(data, ext_hook=extension)
    head = msgpack.packb(fields[0])
    assert data[3 : 3 + len(head)] == head
    behind = data[len(data) - fields[-1] :]
    unpacker = msgpack.Unpacker(ext_hook=extension)
    unpacker.feed(behind)
    assert tagged([*unpacker][:-1]) == tagged(fields[12:-1])


@pytest.fixture(scope="session")
def javascript_library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of @msgpack/msgpack, installed once; skips where there is no Node.js or no registry."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("there is no Node.js here")
    cache = getattr(request.config, "cache", None)
    folder = tmp_path_factory.mktemp("npm") if cache is None else Path(cache.mkdir("npm"))
    prefix = folder / NPM_PACKAGE.replace("/", "-")
    library = prefix / "node_modules" / "@msgpack" / "msgpack"
    if not (library / "package.json").exists():
        prefix.mkdir(parents=True, exist_ok=True)
        quickly = ("--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-timeout=20000")
        command = [npm, "install", "--prefix", str(prefix), "--no-audit", "--no-fund", *quickly, NPM_PACKAGE]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        if done.returncode != 0:  # no registry, no certificate, no right to it: not ours to judge
            pytest.skip(f"npm cannot install {NPM_PACKAGE}: {done.stderr.strip()[:300]}")
    return library


def test_javascript_reads_our_bytes(javascript_library: Path, tmp_path: Path) -> None:
    paths = []
    for name, data in encoded().items():
        paths.append(tmp_path / name)
        paths[-1].write_bytes(data)
    script = Path(__file__).with_name("decode.mjs")
    command = ["node", str(script), str(javascript_library), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(paths) == len(FILES)
    for path, line in zip(paths, lines, strict=True):
        assert json.loads(line) == expected(FOLDER / path.name), path.name
