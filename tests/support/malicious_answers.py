"""What is no launch and answers like one: whatever it is asked, with values made to harm who asks.

Run as a program, it is as many launches as there are answers; it prints where, and stays until its input ends.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hierax.runtime.transport.zenoh_session import free_endpoint, open_session
from hierax.schemas.values import encode_value
from support.malice import CLAIMS, Attack, Place

ENDPOINTS = "HIERAX_TEST_ENDPOINTS"
STATUS: dict[str, Any] = {"hierarchy": "live", "run": "5163af85", "epoch": 1, "roster": 0, "nodes": {}}
_NODE = {"process": "5f", "state": "running", "pid": 1, "instance": 0, "restarts": 0}
_ESCAPES = "\x1b[2J\x1b]0;owned\x07"
ANSWERS: dict[str, bytes] = {
    **{f"ps answers {what}": each for what, each in CLAIMS.items()},
    "ps answers nothing but who it is": encode_value({"hierarchy": "live", "run": "5163af85"}),
    "ps answers nodes that are none": encode_value({**STATUS, "nodes": {"low": 3}}),
    "ps answers nodes with too little": encode_value({**STATUS, "nodes": {"low": {"process": "5f", "state": "x"}}}),
    "ps answers characters that move the cursor": encode_value({**STATUS, "nodes": {_ESCAPES: _NODE}}),
    "ps answers states that move the cursor": encode_value({**STATUS, "nodes": {"low": {**_NODE, "state": _ESCAPES}}}),
    "ps refuses with characters that move the cursor": encode_value({**STATUS, "refusal": _ESCAPES}),
    "attach, and the file is a device": encode_value({**STATUS, "file": "/dev/zero", "settings": []}),
    "attach, and the file is a number": encode_value({**STATUS, "file": 3, "settings": [3]}),
    "attach, and the settings call os.system": encode_value(
        {**STATUS, "file": "toys.yaml", "settings": ["nodes.left.class=os:system"]}
    ),
    "record answers a run called ../..": encode_value({**STATUS, "format": 2}),
    "top answers nodes that are none": encode_value({**STATUS, "nodes": {"low": 3}}),
    "inspect answers nodes that are none": encode_value({**STATUS, "nodes": {"left": 3}}),
    "view answers nodes that are none": encode_value({**STATUS, "nodes": {"left": 3}}),
    "echo answers nodes that are none": encode_value({**STATUS, "nodes": {"left": 3}}),
}
_ASKED: Mapping[str, Callable[[Place], Sequence[str]]] = {
    "ps": lambda place: ("ps",),
    "attach,": lambda place: (
        "attach",
        str(place.file("s.yaml", "nodes:\n  top: {class: support.toy_nodes:Summer}\n")),
    ),
    "record": lambda place: ("record", "-o", str(place.folder / "out.mcap")),
    "top": lambda place: ("top", "--once"),
    "inspect": lambda place: ("inspect", "left"),
    "view": lambda place: ("view", "--save", str(place.folder / "seen.rrd")),
    "echo": lambda place: ("echo", "obs/world/left"),
}


def _answered(name: str) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        endpoint = json.loads(os.environ[ENDPOINTS])[name]
        return (*_ASKED[name.split()[0]](place), "--connect", endpoint)

    return made


def answer_all() -> None:
    """Be as many launches as there are answers; print where, and stay until the input ends."""
    endpoints, sessions = {}, []
    for name, data in ANSWERS.items():
        endpoint = free_endpoint()
        session = open_session([endpoint], shared_memory=False)

        def on_query(query: Any, data: bytes = data) -> None:
            with query:
                query.reply("hierax/live/5163af85/launch", data)

        session.declare_queryable("hierax/live/5163af85/launch", on_query)
        endpoints[name] = endpoint
        sessions.append(session)
    print(json.dumps(endpoints), flush=True)
    sys.stdin.read()
    os._exit(0)


ATTACKS = {name: Attack(_answered(name), "", (0, 1)) for name in ANSWERS}

if __name__ == "__main__":
    answer_all()
