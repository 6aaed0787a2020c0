from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from contextlib import nullcontext
from typing import Any, cast

import pytest
from support.live import Live

from hierax.runtime.commands import echo
from hierax.runtime.commands.echo import echoes, line
from hierax.runtime.commands.main import main
from hierax.runtime.tools.echoes import Echo
from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus
from hierax.schemas.keys import STEP, Keys
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, TASKS, Header, Message, encode_message
from hierax.schemas.values import encode_value

KEYS = Keys("shown", "5f")


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


@pytest.mark.parametrize("output_format", ["text", "json"])
def test_standard_output_has_messages_alone(
    output_format: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = Echo(Message(Header(OBSERVATIONS, "world", "arm", 1), ()), 77, None, 0)
    monkeypatch.setattr(echo, "launch_meant", lambda *_: None)
    monkeypatch.setattr(echo, "client_at", lambda _: nullcontext())
    monkeypatch.setattr(echo, "echoes", lambda *_: iter([seen]))  # and the launch is over
    assert main(["echo", "**", "--format", output_format]) == 0
    told = capsys.readouterr()
    assert len(told.out.splitlines()) == (1 if output_format == "json" else 2)
    assert told.err == "hierax: the launch is over\n"


class Shown:
    """A launch of ``world -> arm`` which shows these things, each on its key."""

    def __init__(self, things: Collection[tuple[str, bytes]]) -> None:
        self._things = things

    def keys(self) -> Keys:
        return KEYS

    def status(self) -> LaunchStatus:
        return LaunchStatus(KEYS.deployment, KEYS.run, 1, 0, {"world": {}, "arm": {}})

    def edges(self, status: LaunchStatus) -> list[tuple[str, str]]:
        return [("world", "arm")]

    def ask_nodes(self, status: LaunchStatus, question: Any, names: Collection[str]) -> dict[str, Any]:
        return {}

    def listen(self, key: str, heard: Callable[[str, bytes], None]) -> None:
        for each in self._things:
            heard(*each)


def test_who_shows_what_is_none_of_its_messages_is_not_listened_to(caplog: pytest.LogCaptureFixture) -> None:
    def message(kind: str, sender: str, receiver: str, epoch: int) -> bytes:
        return encode_message(Message(Header(kind, sender, receiver, epoch), ("x",)))

    shown = [
        (KEYS.seen(STEP, "arm", "arm"), encode_value({"done_ns": 1})),  # for a viewer
        (KEYS.seen(OBSERVATIONS, "world", "arm"), message(OBSERVATIONS, "world", "arm", 1)),
        (KEYS.seen(CONTEXT, "arm", "nobody"), message(OBSERVATIONS, "world", "arm", 2)),
        (KEYS.seen(CONTEXT, "arm", "world"), message(OBSERVATIONS, "world", "arm", 3)),
        (KEYS.seen(TASKS, "arm", "world"), b"junk"),
        (KEYS.seen(TASKS, "arm", "world"), b""),
        (KEYS.seen(CONTEXT, "arm", "world"), message(CONTEXT, "arm", "world", 4)),
    ]
    came: Iterator[Echo] = echoes(cast("LaunchClient", Shown(shown)), "**")
    seen = [next(came).message.header for _ in range(2)]
    assert seen == [Header(OBSERVATIONS, "world", "arm", 1), Header(CONTEXT, "arm", "world", 4)]
    (warning,) = caplog.messages
    assert warning.startswith("ctx/arm/world: left out, as all else that is no message of its key: message: expected")


def test_somebody_who_views_the_launch_is_no_matter(live: Live, capsys: pytest.CaptureFixture[str]) -> None:
    came: list[str] = []
    with LaunchClient(live.endpoint, secret=live.secret) as viewer:
        viewer.listen(viewer.keys().seen(STEP, "*", "*"), lambda key, _: came.append(key))
        status = viewer.status()
        viewer.ask_nodes(status, {"look": "steps", "every": 1}, status.nodes)
        assert main(["echo", "**", "-n", "100"]) == 0
    assert came
    assert capsys.readouterr().out.count(" epoch ") == 100
