"""Somebody who has no key of a run, or a wrong one, and tries all the same: another user where root starts it.

Run as ``python attacks.py ORDER.json`` with ``user``, ``endpoints``, ``hierarchy``, ``run``, ``tokens`` (of the
processes, by node), ``secrets`` (by what they are; null: none), ``messages`` and ``bytes`` (of the floods). It prints
JSON: by secret and mode, by attack, how much came of it. A secret with an authority shows a certificate by it.
Doors are where another user cannot go, so the run's own user, too, tries them. With ``links_only`` it links and does
nothing more.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh

from hierax.runtime.host.run_secret import USER, certificates_of, issued, token_of
from hierax.runtime.transport.zenoh_session import encrypted
from hierax.schemas.access import OPERATOR

MODES = ("client", "peer")
NOBODY = 65534
TIMEOUT_S = 300.0
LINKED_S = 0.5  # how long a session may take to have what it can have
IDLE = 150  # connections that say nothing

_LISTENS = "00010000"  # of a socket, in what Linux tells of flags

Outcome = dict[str, dict[str, int]]


def order_for(live: Any, secrets: dict[str, str | None], messages: int, size: int) -> dict[str, Any]:
    """What is attacked: a `support.live.Live`, with floods of so many messages and bytes."""
    run = live.run
    pids = [live.launch.process.pid, *(node["pid"] for node in run["nodes"].values())]
    endpoints = ports_of(pids)
    assert len(endpoints) > len(run["nodes"]), endpoints
    doors = doors_of(pids)
    if live.endpoint.startswith("tls/"):
        endpoints = [endpoint.replace("tcp/", "tls/") for endpoint in endpoints] + endpoints
    assert live.endpoint in endpoints
    return {
        "pids": pids,
        "endpoints": [*endpoints, *doors],
        "doors": doors,
        "hierarchy": run["hierarchy"],
        "run": run["run"],
        "tokens": {name: node["process"] for name, node in run["nodes"].items()},
        "secrets": secrets,
        "messages": messages,
        "bytes": size,
        "links_only": False,
    }


def linked(live: Any, order: dict[str, Any], folder: Path) -> dict[str, int]:
    """How many links somebody has by who has the run's own key, and how, where attacks are made; it does nothing with
    them. There have to be some: else attacks come to nothing for another reason."""
    live.is_attacked = True  # by who goes by no list of its own
    outcome = attacked({**order, "secrets": {"the run's own key": live.secret}, "links_only": True}, folder)
    return {who: each.get("links", 0) for who, each in outcome.items()}


def attacked(order: dict[str, Any], folder: Path) -> Outcome:
    """What comes of all attacks, made by another user where that can be, and at doors by the run's own."""
    own = os.getuid()
    outcome = _attacked_by(NOBODY if own == 0 else own, order, folder)
    if order["doors"]:
        at_doors = _attacked_by(own, {**order, "endpoints": order["doors"]}, folder)
        outcome |= {f"the run's user at doors, {name}": each for name, each in at_doors.items()}
    return outcome


def _attacked_by(user: int, order: dict[str, Any], folder: Path) -> Outcome:
    path = folder / "attacks.json"
    path.write_text(json.dumps({"user": user, **order}), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, __file__, str(path)], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    outcome: Outcome = json.loads(done.stdout)
    return outcome


def ports_of(pids: list[int]) -> list[str]:
    """Where processes listen, as anybody may look up."""
    sockets = _sockets_of(pids)
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets]
    return [f"tcp/127.0.0.1:{int(address.partition(':')[2], 16)}" for address in listening]


def doors_of(pids: list[int]) -> list[str]:
    """The sockets in the run's folder at which processes listen."""
    sockets = _sockets_of(pids)
    rows = [line.split() for line in Path("/proc/net/unix").read_text().splitlines()[1:]]
    listening = [row[7] for row in rows if len(row) == 8 and row[3] == _LISTENS and f"socket:[{row[6]}]" in sockets]
    return [f"unixsock-stream/{path}" for path in listening if path.endswith(".door")]


def _sockets_of(pids: list[int]) -> set[str]:
    found = set()
    for pid in pids:
        for file in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                found.add(os.readlink(file))
    return found


def main() -> None:
    """Make all attacks, and print what came of them."""
    order = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    admissions = {name: _admission(secret) for name, secret in order["secrets"].items()}
    "".encode("idna")  # which sockets look up, where the other user may not read Python's library
    if order["user"] != os.getuid():
        os.setgroups([])
        os.setgid(order["user"])
        os.setuid(order["user"])
    os.environ["RUST_LOG"] = "off"
    outcome = {
        f"{name}, {mode}": each
        for name, admission in admissions.items()
        for mode in MODES
        for each in [_by_zenoh(order, admission, mode)]
    }
    if not order["links_only"]:
        outcome["bytes"] = {"connections that were answered": _by_bytes(order)}
    json.dump(outcome, sys.stdout)
    sys.stdout.flush()
    os._exit(0)


def _admission(secret: str | None) -> dict[str, Any]:
    """Zenoh's settings for who has a secret."""
    if secret is None:
        return {}
    settings: dict[str, Any] = {"transport/auth/usrpwd": {"user": USER, "password": token_of(secret)}}
    if certificates_of(secret):
        settings |= encrypted(issued(secret, OPERATOR, ["127.0.0.1"]))
        del settings["transport/link/protocols"]  # it tries all
    return settings


def _by_zenoh(order: dict[str, Any], admission: dict[str, Any], mode: str) -> dict[str, int]:
    """By attack, how much came of it in a session of its own."""
    config = {
        "mode": mode,
        "listen": {"endpoints": ["tcp/127.0.0.1:0"] if mode == "peer" else []},
        "connect": {"endpoints": order["endpoints"], "timeout_ms": 500, "exit_on_failure": False},
        "scouting": {"multicast": {"enabled": mode == "peer"}},
    }
    settings = zenoh.Config.from_json5(json.dumps(config))
    for path, value in admission.items():
        settings.insert_json5(path, json.dumps(value))
    try:
        session = zenoh.open(settings)
    except zenoh.ZError:
        return {"no session": 0}
    try:
        attacks = _attacks(session, order)
        return dict([next(attacks)] if order["links_only"] else attacks)
    finally:
        session.close()  # type: ignore[no-untyped-call]


def _attacks(session: zenoh.Session, order: dict[str, Any]) -> Iterator[tuple[str, int]]:
    root = f"hierax/{order['hierarchy']}/{order['run']}"
    heard: list[str] = []
    asked: list[str] = []
    tokens: list[str] = []

    def on_query(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        with query:
            query.reply(str(query.key_expr), b"\x80")

    liveliness = session.liveliness()
    session.declare_subscriber("hierax/**", lambda sample: heard.append(str(sample.key_expr)))
    for key in ("launch", "changes", "look/low"):
        session.declare_queryable(f"{root}/{key}", on_query)
    liveliness.declare_subscriber(f"{root}/**", lambda sample: tokens.append(str(sample.key_expr)), history=True)
    own = {f"{root}/alive/{name}/{token}x" for name, token in order["tokens"].items()}
    forged = [liveliness.declare_token(key) for key in sorted(own)]
    time.sleep(LINKED_S)
    yield "links", len(list(session.info.peers_zid())) + len(list(session.info.routers_zid()))
    for key in _keys(root, order["tokens"]):
        publisher = session.declare_publisher(key, allowed_destination=zenoh.Locality.REMOTE)
        publisher.put(b"\x9c\x01")
        publisher.delete()
        yield f"somebody hears put and delete on {key.removeprefix(root)}", int(publisher.matching_status.matching)
        publisher.undeclare()
    for what, key, question in _questions():
        yield f"answers to {what}", _answers(session, f"{root}/{key}", question)
    yield "answers of nodes", _answers(session, f"{root}/look/*", b"\x81\xa4look\xa5state")
    yield "answers to anything", _answers(session, "**", b"\x80")
    alive = [str(reply.ok.key_expr) for reply in liveliness.get(f"{root}/**", timeout=1.0) if reply.ok]
    yield "liveliness seen", len({*alive} - own)
    edge = session.declare_publisher(f"{root}/obs/world/low", allowed_destination=zenoh.Locality.REMOTE)
    for _ in range(order["messages"]):
        edge.put(b"\x9c\x01")
    for _ in range(order["bytes"] >> 20):
        edge.put(bytes(1 << 20))
    yield "somebody hears the floods", int(edge.matching_status.matching)
    for token in forged:
        token.undeclare()
    yield "samples heard", len(heard)
    yield "questions heard", len(asked)
    yield "tokens heard", len([key for key in tokens if key not in own])


def _keys(root: str, tokens: dict[str, str]) -> list[str]:
    edges = [f"{kind}/{pair}" for kind, pair in (("obs", "world/low"), ("task", "low/world"), ("ctx", "high/low"))]
    control = [f"control/{token}" for token in tokens.values()]
    return [
        f"{root}/{key}"
        for key in (
            *edges,
            *control,
            "words/low",
            "launch",
            "changes",
            "epochs",
            "roster",
            "notes",
            "steps/low",
            "look/low",
        )
    ]


def _questions() -> list[tuple[str, str, bytes]]:
    detach = b"\x82\xa3ask\xa6change\xa6change\x93\xa6Detach\xa4high\xc2"
    record = b"\x81\xa3ask\xa6record"
    return [("ps", "launch", b"\x81\xa3ask\xa2ps"), ("detach", "changes", detach), ("record", "launch", record)]


def _answers(session: zenoh.Session, key: str, question: bytes) -> int:
    """How many others answer."""
    replies = session.get(key, payload=question, timeout=1.0, allowed_destination=zenoh.Locality.REMOTE)
    return len([reply for reply in replies if reply.ok is not None])


def _by_bytes(order: dict[str, Any]) -> int:
    """Connections without a word of Zenoh's, with others' words, and with too many of them; how many were answered."""
    answered = 0
    tries: list[Callable[[socket.socket], object]] = [
        lambda link: link.sendall(b"GET / HTTP/1.0\r\n\r\n"),
        lambda link: link.sendall(b"\xff\xff" + b"x" * 65535),
        lambda link: [link.sendall(os.urandom(1 << 20)) for _ in range(order["bytes"] >> 20)],
    ]
    idle = []
    for endpoint in order["endpoints"]:
        for attack in tries:
            with suppress(OSError), _connected(endpoint, 5.0) as link:
                link.settimeout(1.0)
                with suppress(OSError):
                    attack(link)
                answered += len(link.recv(64)) > 64
    for number in range(IDLE):
        with suppress(OSError):
            idle.append(_connected(order["endpoints"][number % len(order["endpoints"])], 1.0))
    time.sleep(LINKED_S)
    for link in idle:
        link.close()
    return answered


def _connected(endpoint: str, timeout_s: float) -> socket.socket:
    kind, _, where = endpoint.partition("/")
    if kind != "unixsock-stream":
        return socket.create_connection(("127.0.0.1", int(where.rpartition(":")[2])), timeout_s)
    link = socket.socket(socket.AF_UNIX)
    link.settimeout(timeout_s)
    link.connect(where)
    return link


if __name__ == "__main__":
    main()
