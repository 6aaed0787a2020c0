"""The line between a roster's owner and the processes; what goes along it may be lost, and is said again."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import zenoh

from hierax.schemas.control import Control, decode_control, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.limits import MAX_STATE_BYTES

OWNER = "owner"  # the owner's address among the control keys; a process's is its token
SUPERVISOR = "keeper"  # the supervisor's address among them

_log = logging.getLogger("hierax")


class ControlLine:
    """Control messages of one process.

    Args:
        session: an open session.
        keys: of the run.
        address: where this end is reached.
        accepts: the kinds of messages that are for this end; others are refused, and logged.
        heard: called with each message and its size in bytes, in a thread of Zenoh's: it must not take long.
        most_bytes: how long a message the session's links carry; None: any. A longer one is not sent, and logged.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        address: str,
        accepts: tuple[type, ...],
        heard: Callable[[Control, int], None],
        most_bytes: int | None = None,
    ) -> None:
        self._session = session
        self._most_bytes = most_bytes
        self._keys = keys
        self._address = address
        self._accepts = accepts
        self._heard = heard
        self._subscriber: Any = session.declare_subscriber(keys.control(address), self._on_sample)

    def send(self, address: str, control: Control) -> None:
        """Send a message; any thread may call it."""
        try:
            data = encode_control(control)
        except SchemaError as error:
            _log.warning("not sent: %s for %s: %s", type(control).__name__, address, error)
            return
        if self._most_bytes is not None and len(data) > self._most_bytes:
            what = f"{type(control).__name__} of {len(data)} bytes"
            _log.warning("not sent: %s for %s; low-latency links carry at most %d", what, address, self._most_bytes)
            return
        try:
            self._session.put(
                self._keys.control(address),
                data,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        except zenoh.ZError as error:
            _log.info("a control message is not sent: %s", error)  # closing, or cut off: it is said again

    def _on_sample(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        try:
            if size > MAX_STATE_BYTES:
                raise SchemaError(f"{size} bytes; at most {MAX_STATE_BYTES} are allowed", "control")
            control = decode_control(sample.payload.to_bytes())
        except SchemaError as error:
            _log.warning("dropped what is no control message: %s", error)
            return
        if isinstance(control, self._accepts):
            self._heard(control, size)
        else:
            _log.warning("refused %s for %s: nobody says that there", type(control).__name__, self._address)
