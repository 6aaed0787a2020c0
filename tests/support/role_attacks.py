"""Somebody who has a certificate of a run, and tries what its role may not.

A witness beside it holds others to the same list as the run's processes do, and hears whatever is let through."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Literal

import zenoh

from hierax.runtime.host.run_secret import issued
from hierax.runtime.transport.access_control import access_control
from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import close_session, open_session
from hierax.schemas.access import LATER, LAUNCH, OPERATOR, READER, Access
from hierax.schemas.keys import Keys
from hierax.schemas.values import encode_value
from support.live import Live, until

FORGED = b"forged"
FLOOD = b"flood"
ASKED_S = 1.0  # how long answers are waited for
HEARD_S = 0.5  # how long what is said may take to be heard
QUESTION_EVERY = 100  # messages of a flood: so many fewer are questions, each of which may be answered
Mode = Literal["client", "peer"]
Outcome = dict[str, dict[str, int]]


class RoleAttack:
    """Attacks on a `Live` of processes world, low and high. What comes of each is counted; 0: nothing. A witness
    that is not `listed` lets all do all: so it is seen that attacks are made."""

    def __init__(self, live: Live, listed: bool = True) -> None:
        run = live.run
        self.keys = Keys(run["hierarchy"], run["run"])
        self._live = live
        live.is_attacked = True
        self._tokens = {name: node["process"] for name, node in run["nodes"].items()}
        self.access = Access("world", {name: (name,) for name in self._tokens})
        # by role, in whose name it may speak, and what it may hear
        self.roles = {READER: "", OPERATOR: "", LATER: "", "high": "high"}
        self._forgeries: list[str] = []
        self._alive: list[str] = []
        self.flooded = 0  # how much of the last flood is heard
        self.witness = self._open(LAUNCH, "peer", access_control(self.keys, self.access) if listed else None)
        self.witness.declare_subscriber(self.keys.everything, self._hear)
        self.witness.liveliness().declare_subscriber(self.keys.alive("*"), self._see, history=True)
        until(lambda: len(self._alive) >= len(self._tokens), "the processes, by the witness")

    def close(self) -> None:
        """End it."""
        close_session(self.witness)

    def all(self) -> Outcome:
        """What comes of all attacks, by who and how it links."""
        modes: tuple[Mode, ...] = ("client", "peer")
        return {f"{who}, {mode}": dict(self.by(who, mode)) for who in self.roles for mode in modes}

    def by(self, who: str, mode: Mode) -> Iterator[tuple[str, int]]:
        """What comes of attacks by one role."""
        keys, own = self.keys, self.roles[who]
        role = self.access.role_of(who) if own else who
        session = self._open(role, mode)
        heard: list[str] = []  # of what is another one's
        asked: list[str] = []

        def on_query(query: zenoh.Query) -> None:
            asked.append(str(query.key_expr))
            with query:
                query.reply(str(query.key_expr), FORGED)

        def on_sample(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr)
            if not _is_forged(sample) and not (own and key.endswith(f"/{own}")):  # it hears itself, too
                heard.append(key)

        try:
            answers = [keys.launch, keys.changes, *(keys.look(name) for name in self._tokens if name != own)]
            declared = [session.declare_queryable(key, on_query) for key in answers]
            every = (keys.everything, keys.inbox(own or "nobody"), keys.inbox("low"), keys.control(self._tokens["low"]))
            declared += [session.declare_subscriber(key, on_sample) for key in every]
            others = [name for name in self._tokens if name != own]
            forged = [keys.alive(name, f"{name}~forged") for name in others]
            forged += [keys.alive(own, self._tokens[name]) for name in others if own]  # their processes as its own
            declared += [session.liveliness().declare_token(key) for key in forged]
            if mode == "peer":
                until(lambda: self.witness.zid() in session.info.peers_zid(), "a link to the witness")
            time.sleep(HEARD_S)
            self._forgeries.clear()
            for key in self._foreign(own):
                session.put(key, FORGED)
                session.delete(key)
            yield "answers that are forged", self._forged_answers()
            yield "questions heard", len(asked)
            if who != OPERATOR:
                yield "changes answered", self._answers(session, keys.changes)
            time.sleep(HEARD_S)
            # a later node may put on keys with wildcards among those of its kind, which nobody takes for a neighbour's
            yield "puts and deletes heard", len([key for key in self._forgeries if who != LATER or "*" not in key])
            yield "tokens seen", len([key for key in self._alive if key in forged])
            if who not in (READER, OPERATOR):
                yield "samples of others heard", len(heard)
        finally:
            close_session(session)

    def floods(self, messages: int, size: int) -> Outcome:
        """What comes of floods, of so many messages and of so many bytes, by who and how it links: how much of them is
        heard where the role may not speak. Where it may speak or ask, all is for the run's processes to bear."""
        modes: tuple[Mode, ...] = ("client", "peer")
        return {f"{who}, {mode}": self.flood(who, mode, messages, size) for who in self.roles for mode in modes}

    def flood(self, who: str, mode: Mode, messages: int, size: int) -> dict[str, int]:
        """A flood by one role."""
        keys, own = self.keys, self.roles[who]
        session = self._open(self.access.role_of(who) if own else who, mode)
        try:
            if mode == "peer":
                until(lambda: self.witness.zid() in session.info.peers_zid(), "a link to the witness")
            self.flooded = 0
            for key in (keys.edge("obs", "world", "low"), keys.words("low"), keys.launch):
                _flood(session, key, messages, size)
            time.sleep(HEARD_S)
            heard = self.flooded
            for key in {LATER: [keys.words("more"), keys.edge("ctx", "more", "low")], own: [keys.words(own)]}.get(
                who, []
            ):
                _flood(session, key, messages, size)
            for _ in range(messages // QUESTION_EVERY):
                session.get(keys.launch, lambda reply: None, payload=FLOOD, timeout=ASKED_S)
            return {f"floods of {messages} messages and {size >> 20} MB heard": heard}
        finally:
            close_session(session)

    def _foreign(self, own: str) -> list[str]:
        """Keys on which only others may speak."""
        keys = self.keys
        edges = [("obs", "world", "low"), ("obs", "low", "high"), ("task", "low", "world"), ("ctx", "low", "world")]
        edges += [("ctx", "high", "low"), ("task", "high", "low"), ("obs", "*", "low"), ("ctx", "*", "*")]
        found = [keys.edge(*edge) for edge in edges if edge[1] != own]
        found += [keys.seen(*edge) for edge in edges if edge[1] != own]
        found += [keys.control(token) for token in self._tokens.values()]
        others = [name for name in self._tokens if name != own]
        found += [key for name in others for key in (keys.words(name), keys.steps(name), keys.look(name))]
        return [*found, keys.launch, keys.changes, keys.epochs, keys.roster, keys.notes, keys.everything]

    def _forged_answers(self) -> int:
        forged = 0
        for key in (self.keys.launch, self.keys.look("*")):
            replies = self.witness.get(key, payload=encode_value({}), target=zenoh.QueryTarget.ALL, timeout=ASKED_S)
            forged += len([reply for reply in replies if reply.ok and reply.ok.payload.to_bytes() == FORGED])
        return forged

    def _answers(self, session: zenoh.Session, key: str) -> int:
        question = encode_value({"ask": "change"})
        replies = session.get(key, payload=question, timeout=ASKED_S, allowed_destination=zenoh.Locality.REMOTE)
        return len([reply for reply in replies if reply.ok])

    def _open(self, role: str, mode: Mode, access: Any = None) -> zenoh.Session:
        listen = ["tls/127.0.0.1:0"] if mode == "peer" else []
        secret = issued(self._live.secret, role, ["127.0.0.1"])
        try:
            return open_session(listen, [self._live.endpoint], None, False, mode, secret=secret, access=access)
        except TransportError as error:
            raise AssertionError(f"{role} is let in as a {mode}, and was not: {error}") from error

    def _hear(self, sample: zenoh.Sample) -> None:
        if sample.payload.to_bytes().startswith(FLOOD):
            self.flooded += 1
        elif _is_forged(sample):
            self._forgeries.append(str(sample.key_expr))

    def _see(self, sample: zenoh.Sample) -> None:
        self._alive.append(str(sample.key_expr))


def _flood(session: zenoh.Session, key: str, messages: int, size: int) -> None:
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    for _ in range(messages):
        publisher.put(FLOOD)
    for _ in range(size >> 20):
        publisher.put(FLOOD.ljust(1 << 20))
    publisher.undeclare()


def _is_forged(sample: zenoh.Sample) -> bool:
    """Whether an attack has said it; the run's own processes delete nothing."""
    return sample.kind == zenoh.SampleKind.DELETE or sample.payload.to_bytes() == FORGED
