"""The line between a roster's owner and the processes; what goes along it may be lost, and is said again."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from hierax.schemas.control import Control, decode_control, encode_control
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.limits import MAX_STATE_BYTES

OWNER = "owner"  # the owner's address among the control keys; a process's is its token
SUPERVISOR = "keeper"  # the supervisor's address among them

_log = logging.getLogger("hierax")


@dataclass(eq=False, repr=False)
class ControlLine:
    """Control messages of one process."""

    session: zenoh.Session  # an open session
    keys: Keys  # of the run
    address: str  # where this end is reached
    accepts: tuple[type, ...]  # the kinds of messages that are for this end; others are refused, and logged
    heard: Callable[[Control, int], None]  # told each message and its bytes, in Zenoh's thread: must not take long
    most_bytes: int | None = None  # what the session's links carry; None: any. Longer ones are not sent, and logged

    def __post_init__(self) -> None:
        self._subscriber: Any = self.session.declare_subscriber(self.keys.control(self.address), self._on_sample)

    def send(self, address: str, control: Control) -> None:
        """Send a message; any thread may call it."""
        try:
            data = encode_control(control)
        except SchemaError as error:
            _log.warning("not sent: %s for %s: %s", type(control).__name__, address, error)
            return
        if self.most_bytes is not None and len(data) > self.most_bytes:
            what = f"{type(control).__name__} of {len(data)} bytes"
            _log.warning("not sent: %s for %s; low-latency links carry at most %d", what, address, self.most_bytes)
            return
        try:
            self.session.put(
                self.keys.control(address),
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
        if isinstance(control, self.accepts):
            self.heard(control, size)
        else:
            _log.warning("refused %s for %s: nobody says that there", type(control).__name__, self.address)
