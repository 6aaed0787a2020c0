from __future__ import annotations

import json

import pytest
from support.live import Live

from hierax.runtime.commands.echo import line
from hierax.runtime.commands.main import main
from hierax.runtime.tools.echoes import Echo
from hierax.schemas.messages import CONTEXT, Header, Message


def test_messages_as_lines_of_json(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["echo", "obs/world/low", "--count", "100", "--format", "json"]) == 0
    told = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    assert [(each["kind"], each["sender"], each["receiver"]) for each in told] == [("obs", "world", "low")] * 100
    epochs = [each["epoch"] for each in told]
    assert epochs == sorted(set(epochs))
    assert told[0]["rate_hz"] is None
    assert told[-1]["rate_hz"] > 0
    assert all(each["size"] > 20 for each in told)


def test_wildcards(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["echo", "**", "-n", "40", "--format", "json"]) == 0
    told = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    keys = {"/".join((each["kind"], each["sender"], each["receiver"])) for each in told}
    assert keys == {"obs/world/low", "obs/low/high", "task/low/world", "task/high/low", "ctx/low/world", "ctx/high/low"}


def test_text_shows_the_payload(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["echo", "ctx/high/*", "-n", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("ctx/high/low epoch ")
    assert lines[0].endswith(" bytes")
    assert lines[1].startswith("  ")


def test_a_key_that_there_is_not(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["echo", "obs/wordl/low"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "did you mean 'obs/world/low'?" in said.err


def test_the_run_is_the_same_with_someone_who_listens(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["echo", "**", "-n", "20"]) == 0
    live.goes_on()


def test_gaps_and_attempts_are_told() -> None:
    message = Message(Header(CONTEXT, "top", "arm", 12, attempt=2), ("x",))
    assert line(Echo(message, 77, 31.25, 4)) == (
        "ctx/top/arm epoch 12, attempt 2 (4 before it not seen): 31.25/s, 77 bytes\n  ['x']"
    )
