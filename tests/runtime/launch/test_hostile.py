"""What is said to a launch by somebody who is no part of it: it goes on, or ends with one line that names whom."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import pytest
from support.hostile import Stranger
from support.launched import processes_of
from support.live import Live, until

from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.launch.requests import MAX_CHANGES
from hierax.runtime.transport.inbox import WAITING_BYTES
from hierax.schemas.control import Census, Dismiss, Fetch, Join, Lost, Prepare, Ready, Resend, Status, Taken
from hierax.schemas.keys import Keys
from hierax.schemas.messages import CONTEXT, OBSERVATIONS, Message
from hierax.schemas.roster import Attach, Reference, RosterEdge
from hierax.schemas.values import Value


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    launch = Live(tmp_path)
    yield launch
    launch.close()


@pytest.fixture
def stranger(live: Live) -> Iterator[Stranger]:
    with Stranger(live.endpoint, Keys("live", str(live.run["run"])), secret=live.secret) as stranger:
        yield stranger


def memory_at_most(pid: int) -> int:
    """How many bytes a process had at most."""
    return int(re.findall(r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text())[0]) << 10


def ends_with(live: Live, *words: str) -> None:
    """The launch fails, and says why in one line that has these words."""
    assert live.launch.ends() == 1
    errors = [line for line in live.launch.err if line.startswith("error: ")]
    assert len(errors) == 1, live.launch.err
    assert all(word in errors[0] for word in words), errors
    assert not any("Traceback" in line for line in live.launch.err)


def test_words_that_cannot_be_change_nothing(live: Live, stranger: Stranger) -> None:
    tokens = {name: str(node["process"]) for name, node in live.run["nodes"].items()}
    roster = {"nodes": {}, "edges": (), "world": "world", "version": 1, "instances": {"low": 7}}
    epoch = 0
    for name, token in tokens.items():
        stranger.say(token, Dismiss("go away"))
        stranger.say(token, Dismiss("go away", again=True))
        stranger.say(token, Prepare(roster))
        stranger.say(token, Prepare({**roster, "version": 10**12, "instances": {}}))
        stranger.say(token, Prepare({"version": "x"}))
        for word in (
            Lost(name, token, False),
            Lost(name, "", False),
            Census({name: "somebody"}),
            Join(name, token, "", 10**12, True, "", 0, 0),
            Join(name, "stranger", "", 10**12, True, "", 0, 0),
            Join(name, "stranger", "", 10**12, False, "", 0, 0),
            Join(name, token, "", 1, True, "", 10**9, 0),
            Ready(name, token, 10**9, "no"),
            Taken(name, 10**9, ""),
            Status(name, 1, 10**12, 0, (), ""),
            Fetch(name, token, 10**9),
            Lost("nobody", "x", True),
        ):
            stranger.say("owner", word)
        for number in range(1000):
            epoch = epoch if number % 20 else live.epoch
            stranger.say(token, Resend(epoch, 0, ("low", "high", "world")))
            stranger.say("owner", Fetch(name, token, 0))
    live.goes_on()
    running = live.run["nodes"]
    assert {name: str(node["process"]) for name, node in running.items()} == tokens, live.launch.err
    stop = live.folder / "stop"
    stop.touch()
    assert live.launch.ends() == 0, live.launch.err
    stop.unlink()


QUESTIONS: list[object] = [
    b"",
    b"\xc1",
    None,
    [],
    {"look": {}},
    {"look": ["state"]},
    {"look": "steps", "every": 1e400},
    {"look": "steps", "every": "9" * 5000},
    {"look": "echo", "edges": ((1, 2, 3),)},
    {"ask": {}},
    {"ask": ["record"]},
    {"ask": "change", "change": {}},
    {"ask": "change", "change": {"change": ["attach"]}},
]


def test_questions_that_are_none_are_refused(live: Live, stranger: Stranger) -> None:
    keys = stranger.keys
    for key in (*(keys.look(name) for name in live.run["nodes"]), keys.launch, keys.changes):
        until(lambda key=key: stranger.ask(key, {}), f"an answer on {key}")
        for question in QUESTIONS:
            (answer,) = stranger.ask(key, question)
            assert "refusal" in answer, (key, question, answer)
    live.goes_on()


def test_a_dismissal_of_a_process_that_is_kept_elsewhere_is_asked_about(live: Live, stranger: Stranger) -> None:
    path = live.snippet("top", "high", policy=", on_loss: restart")
    keeper = live.start("attach", path, "--here", "--deployment", str(live.file))
    first = int(keeper.says("attached top at epoch").split()[-1])
    token = live.run["nodes"]["top"]["process"]
    stranger.reaches(stranger.keys.control(token))
    stranger.say(token, Dismiss("go away"))
    keeper.says("somebody has dismissed its process, and not the launch; it is started again")
    until(lambda: live.run["nodes"].get("top", {}).get("process") not in (None, token), "another process")
    live.goes_on()
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"], f"{first}:attach:{path}")["digest"], live.launch.err
    assert keeper.ends() == 0, (keeper.err, live.launch.err)
    assert keeper.err[-1] == "hierax: top: its process exits: top: the run is over\n"


def test_what_waits_for_a_node_in_an_operator_is_bounded_by_its_bytes(live: Live, stranger: Stranger) -> None:
    size, count = 64 << 20, 14
    pid = live.run["nodes"]["world"]["pid"]
    before = memory_at_most(pid)
    pause = live.folder / "pause"
    pause.touch()
    for _ in range(count):
        stranger.put(stranger.keys.edge(CONTEXT, "low", "world"), bytes(size))
    pause.unlink()
    live.goes_on()
    assert memory_at_most(pid) - before < WAITING_BYTES + 5 * size < count * size
    assert any("world: dropped ctx messages from low: too much waits" in line for line in live.launch.err)
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"])["digest"], live.launch.err


ZENOH_LONGEST = "zenoh={transport: {link: {rx: {max_message_size: 1000000}}}}"


@pytest.mark.parametrize("setting", ["low_latency=true", ZENOH_LONGEST])
def test_where_messages_are_short_long_ones_are_not_put_together(setting: str, tmp_path: Path) -> None:
    live = Live(tmp_path, "--set", setting)
    size, sessions = 32 << 20, 4
    try:
        pid = live.run["nodes"]["world"]["pid"]
        before = memory_at_most(pid)
        strangers = [
            Stranger(live.endpoint, Keys("live", str(live.run["run"])), secret=live.secret) for _ in range(sessions)
        ]
        with ThreadPoolExecutor(sessions) as pool:
            for stranger in strangers:
                pool.submit(stranger.put, stranger.keys.edge(CONTEXT, "low", "world"), bytes(size))
        live.goes_on()
        assert memory_at_most(pid) - before < size
        for stranger in strangers:
            stranger.close()
        report = live.ends()
        assert report["digest"] == live.repeated(report["epochs"])["digest"], live.launch.err
    finally:
        live.close()


def test_an_attempt_that_nobody_has_begun_is_refused_or_overtaken(live: Live, stranger: Stranger) -> None:
    """Far ahead it is refused; near by the epoch is begun again, after it, or what was done is undone, as it does not
    count; the digests stay as they are.
    """
    for attempt, forged in ((10**9, ()), (7, ()), (5, ("forged",)), (6, ("forged",))):
        seen = stranger.next(OBSERVATIONS, "low", "high")
        payload = (*seen.payload, *forged)
        stranger.send(Message(seen.header._replace(attempt=seen.header.attempt + attempt), payload))
        stranger.send(Message(seen.header._replace(attempt=attempt, epoch=10**12), seen.payload))
        live.goes_on()
    report = live.ends()
    assert report["digest"] == live.repeated(report["epochs"])["digest"], live.launch.err


@pytest.mark.parametrize(("kind", "sender", "receiver"), [(OBSERVATIONS, "world", "low"), (CONTEXT, "high", "low")])
@pytest.mark.parametrize("ahead", [0, 1])
def test_what_is_said_in_a_nodes_name_ends_the_run_with_both_named(
    live: Live, stranger: Stranger, kind: str, sender: str, receiver: str, ahead: int
) -> None:
    def is_over() -> bool:
        """Say it again, as it may come when the epoch is over."""
        with suppress(AssertionError):  # nothing is heard any more
            seen = stranger.next(kind, sender, receiver, timeout_s=1.0)
            for further in range(4):
                header = seen.header._replace(epoch=seen.header.epoch + ahead + further)
                stranger.send(Message(header, (*seen.payload, {"forged": True})))
        return live.launch.process.poll() is not None

    until(is_over, "the end of the run")
    ends_with(live, f"{receiver}: two {kind} messages from {sender} of epoch", f"in the name of {sender}")


def test_of_many_changes_at_once_some_are_begun_and_the_others_refused(live: Live, stranger: Stranger) -> None:
    keeper = stranger.keys.changes
    policy = asdict(ProcessTerms())
    pid = live.launch.process.pid
    most = 0
    until(lambda: stranger.ask(keeper, {}), "the keeper")

    def attach(number: int) -> list[Value]:
        name = f"n{number}"
        node = Reference("hierax.runtime.sim.nodes:Mixer", {"name": name})
        change = Attach({name: node}, (RosterEdge("high", name),))
        question = {"ask": "change", "change": change.plain(), "terms": {name: policy}, "here": False, "host": ""}
        return stranger.ask(keeper, question, 120.0)

    with ThreadPoolExecutor(40) as pool:
        asked = [pool.submit(attach, number) for number in range(200)]
        while not all(each.done() for each in asked):
            most = max(most, len(processes_of(pid)) - len(live.run["nodes"]))
            time.sleep(0.01)
    answers = [answer for each in asked for answer in each.result()]
    refused = [str(answer["refusal"]) for answer in answers if "refusal" in answer]
    assert len(answers) > 150
    assert any(refusal.endswith("changes are under way, and no more may be at once; try again") for refusal in refused)
    assert most <= MAX_CHANGES + 1
    live.goes_on()


def test_many_refusals_are_few_lines(live: Live, stranger: Stranger) -> None:
    edge = stranger.keys.edge(OBSERVATIONS, "world", "low")
    stranger.reaches(edge)
    for number in range(20_000):
        stranger.put(edge, b"\x9c" + bytes([number % 256]))
    live.goes_on()
    live.ends()
    assert len(live.launch.err) < 100
    assert any("more like" in line for line in live.launch.err)
