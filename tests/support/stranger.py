"""Another user's process that has got hold of the run's secret: it names code that is not the launch's wherever it can.

Run as root with the file of its order, JSON with ``user``, ``group``, ``endpoint``, ``secret``, ``roster`` (as
`Roster.plain` gives it) and ``references`` (as `Reference.plain` does); it becomes that user before it opens a session.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

import zenoh

from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.zenoh_session import close_session, open_session
from hierax.schemas.control import Prepare, Propose, encode_control
from hierax.schemas.keys import Keys
from hierax.schemas.values import Value, decode_value, encode_value

PATIENCE_S = 60.0


def main() -> None:
    """Say all of it, then print what was answered."""
    with open(sys.argv[1], encoding="utf-8") as file:
        order = json.load(file)
    os.setgroups([])
    os.setgid(order["group"])
    os.setuid(order["user"])
    endpoint = order["endpoint"]
    with LaunchClient(endpoint, secret=order["secret"]) as client:
        run = client.ask({"ask": "ps"})
    keys = Keys(run["hierarchy"], run["run"])
    session = open_session(connect=[endpoint], shared_memory=False, links="all", secret=order["secret"])
    processes = {name: node["process"] for name, node in run["nodes"].items()}
    refusals: list[str] = []
    try:
        for reference in order["references"]:
            for key in (*map(keys.control, processes.values()), keys.words("low")):
                put(session, key, rosters(order["roster"], reference))
        for reference in order["references"]:
            put(session, keys.words("low"), proposals(reference))
            asked = [(change, here) for change in changes(reference) for here in (False, True)]
            refusals += [supervisor_says(session, keys, change, here) for change, here in asked]
    finally:
        close_session(session)
    json.dump({"user": os.getuid(), "refusals": refusals}, sys.stdout)
    sys.stdout.flush()
    os._exit(0)


def rosters(roster: dict[str, Any], reference: Value) -> Iterator[bytes]:
    """Orders to get ready for a next version, in which every class, or every function, is this one."""
    later = {**roster, "version": roster["version"] + 1}
    yield encode_control(Prepare({**later, "nodes": dict.fromkeys(roster["nodes"], reference)}))
    functions = dict.fromkeys(("sense", "task", "context"), reference)
    yield encode_control(Prepare({**later, "edges": [{**edge, **functions} for edge in roster["edges"]]}))


def changes(reference: Value) -> list[dict[str, Value]]:
    """Changes that bring it in."""
    empty = dict.fromkeys(("sense", "task", "context"))
    edge = {"lower": "low", "upper": "thief", **empty}
    mixer = {"target": "hierax.runtime.sim.nodes:Mixer", "parameters": {"name": "thief"}}
    return [
        {"change": "attach", "nodes": {"thief": reference}, "edges": [edge]},
        {"change": "attach", "nodes": {"thief": mixer}, "edges": [{**edge, "sense": reference}]},
        {"change": "replace", "name": "high", "reference": reference, "edges": None},
    ]


def proposals(reference: Value) -> Iterator[bytes]:
    """The same, as the keeper would hand them on."""
    for number, change in enumerate(changes(reference)):
        yield encode_control(Propose(f"stolen{number}", change))


def put(session: zenoh.Session, key: str, messages: Iterator[bytes]) -> None:
    """Say something where somebody listens."""
    publisher = session.declare_publisher(key)
    patience = time.monotonic() + PATIENCE_S
    while not publisher.matching_status.matching:
        if time.monotonic() > patience:
            raise SystemExit(f"nobody listens at {key}")
        time.sleep(0.01)
    for message in messages:
        publisher.put(message)
    publisher.undeclare()


def supervisor_says(session: zenoh.Session, keys: Keys, change: Value, here: bool) -> str:
    """What the supervisor answers to who asks for a change; empty: it would make it."""
    names = list(change["nodes"]) if "nodes" in change else [change["name"]]
    question = {"ask": "change", "change": change, "terms": {name: {} for name in names}, "here": here, "host": ""}
    replies = session.get(keys.changes, payload=encode_value(question), timeout=PATIENCE_S)
    answers = [decode_value(reply.ok.payload.to_bytes(), "answer") for reply in replies if reply.ok is not None]
    return str(answers[0].get("refusal", "")) if answers else "no answer"


if __name__ == "__main__":
    main()
