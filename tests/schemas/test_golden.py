"""Bytes once written are read for ever, and written again the same."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import pytest
from support.golden import CONTROL, FOLDER, decoded, encoded, plain

from hierax.schemas.control import Control, decode_control, encode_control
from hierax.schemas.messages import Message, encode_message
from hierax.schemas.values import encode_value

FILES = sorted(FOLDER.glob("*.msgpack"))


def test_every_case_has_its_file_and_every_file_its_case() -> None:
    assert [path.name for path in FILES] == sorted(encoded())


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_golden_file_decodes_to_what_stands_beside_it(path: Path) -> None:
    expected = json.loads(path.with_suffix(".json").read_text())
    assert json.dumps(plain(decoded(path))) == json.dumps(expected)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_golden_file_is_encoded_to_the_same_bytes(path: Path) -> None:
    value = decoded(path)
    again = encode_message(value) if isinstance(value, Message) else encode_value(value)
    assert again == path.read_bytes()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_its_source_is_encoded_to_the_same_bytes(path: Path) -> None:
    assert encoded()[path.name] == path.read_bytes()


def test_control_messages_are_encoded_to_the_same_bytes_one_by_one() -> None:
    assert {type(word) for word in CONTROL} == set(get_args(Control))
    written = (FOLDER / "value-control.msgpack").read_bytes()
    words = [encode_control(word) for word in CONTROL]
    assert written.endswith(b"".join(words))
    assert len(written) - len(b"".join(words)) == 3, "the head of an array of more than 15"
    assert [encode_control(decode_control(data)) for data in words] == words
