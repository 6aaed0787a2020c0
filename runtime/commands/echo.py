"""``hierax echo``: the messages of a launch as they go."""

import json
import logging
import queue
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

from hierax.runtime.commands.errors import notify
from hierax.runtime.commands.options import Connect, Format, Full, Key, KeyFile, OutputFormat, Run, option
from hierax.runtime.commands.which_launch import client_at, launch_meant

if TYPE_CHECKING:
    from hierax.runtime.execution.report import Json
    from hierax.runtime.tools.echoes import Echo, Edge
    from hierax.runtime.transport.launch_client import LaunchClient
    from hierax.schemas.messages import Message

ASK_AGAIN_S = 1.5  # well within the time for which nodes show copies when they are asked
QUEUE_SIZE = 10_000  # how many messages wait to be printed; of more than that, new ones are left out

_log = logging.getLogger("hierax")


def echo(
    key: Key,
    run: Run = None,
    connect: Connect = None,
    key_file: KeyFile = None,
    count: Annotated[int | None, option("--count", "-n", min=1)] = None,
    full: Full = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Show messages as they go, with size and rate, until Ctrl-C. The run never waits for this."""
    with client_at(launch_meant(run, connect, key_file)) as client:
        for number, each in enumerate(echoes(client, key), start=1):
            is_json = output_format is Format.json
            print(json.dumps(as_json(each, full), allow_nan=False) if is_json else line(each), flush=True)
            if number == count:
                return 0
    notify("the launch is over")  # standard output has messages alone, as lines of JSON, too
    return 0


def echoes(client: "LaunchClient", pattern: str) -> "Iterator[Echo]":
    """Messages as they come; ends when the launch does."""
    from hierax.runtime.tools.echoes import Counter, edge_of
    from hierax.runtime.transport.port import TransportError
    from hierax.schemas.messages import EDGE_KINDS

    came: queue.Queue[tuple[Edge, bytes]] = queue.Queue(QUEUE_SIZE)

    def heard(key: str, data: bytes) -> None:
        edge = edge_of(key)
        if edge[0] in EDGE_KINDS and not came.full():  # what is left out is seen by its epoch
            came.put_nowait((edge, data))

    _ask(client, pattern)
    client.listen(client.keys().seen("*", "*", "*"), heard)
    wanted = _ask(client, pattern)
    asked_s = time.monotonic()
    counter, reader = Counter(), _Reader()
    while True:
        shown = _next(came, asked_s + ASK_AGAIN_S - time.monotonic())
        if time.monotonic() - asked_s >= ASK_AGAIN_S:
            try:
                wanted = _ask(client, pattern)
            except TransportError:
                return
            asked_s = time.monotonic()
        if shown is not None and shown[0] in wanted:  # another one who looks may want others
            message = reader.read(*shown)
            if message is not None:
                yield counter.take(message, len(shown[1]))


def _next(came: "queue.Queue[tuple[Edge, bytes]]", timeout_s: float) -> "tuple[Edge, bytes] | None":
    """What was shown next, with its edge; None: nothing in this time."""
    try:
        return came.get(timeout=max(timeout_s, 0))
    except queue.Empty:
        return None


class _Reader:
    """Reads what is shown, and leaves out what is no message of its key, which it says once."""

    def __init__(self) -> None:
        self._has_warned = False

    def read(self, edge: "Edge", data: bytes) -> "Message | None":
        from hierax.runtime.tools.echoes import message_of, short_key
        from hierax.schemas.errors import SchemaError

        try:
            return message_of(edge, data)
        except SchemaError as error:
            if not self._has_warned:
                _log.warning("%s: left out, as all else that is no message of its key: %s", short_key(edge), error)
            self._has_warned = True
            return None


def _ask(client: "LaunchClient", pattern: str) -> "set[Edge]":
    """Have the nodes show what is wanted for some seconds more."""
    from hierax.runtime.tools.echoes import chosen, edges_of

    status = client.status()
    wanted = chosen(pattern, edges_of(client.edges(status)))
    senders = {sender for _, sender, _ in wanted}
    client.ask_nodes(status, {"look": "echo", "edges": [list(edge) for edge in wanted]}, senders & status.nodes.keys())
    return set(wanted)


def as_json(echo: "Echo", full: bool = False) -> "Json":
    """A message as plain JSON."""
    from hierax.runtime.execution.report import plain

    header, payload = echo.message
    fields = plain({**header._asdict(), "payload": payload}, full)
    return {**fields, "size": echo.size, "rate_hz": echo.rate_hz, "missed": echo.missed}


def line(echo: "Echo") -> str:
    """A message as a line of text, and what it carries below, where that is long."""
    from hierax.runtime.tools.summary import tree

    header, payload = echo.message
    rate = "" if echo.rate_hz is None else f"{echo.rate_hz:.4g}/s, "
    again = f", attempt {header.attempt}" if header.attempt else ""
    missed = f" ({echo.missed} before it not seen)" if echo.missed else ""
    head = f"{header.kind}/{header.sender}/{header.receiver} epoch {header.epoch}{again}{missed}: {rate}"
    return "\n".join([f"{head}{echo.size} bytes", *tree(payload, depth=1)])
