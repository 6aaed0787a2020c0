"""The supervisor's Zenoh session: the processes of a run find one another through it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zenoh

from hierax.runtime.transport.port import TransportError
from hierax.runtime.transport.zenoh_session import Settings, close_session, free_endpoint, open_session
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys
from hierax.schemas.values import decode_value

_TRIES = 5


class Hub:
    """A session that every process connects to and gossips through; messages of the run don't pass it.

    Args:
        keys: of the run.
        settings: Zenoh's own.
        progress: told the number of each committed epoch, from a thread of Zenoh's.

    Raises:
        TransportError: Zenoh refuses the settings, or no endpoint could be listened on.
    """

    def __init__(self, keys: Keys, settings: Settings, progress: Callable[[int], None] | None) -> None:
        self.endpoint, self._session = _listen(settings)
        self._subscriber: Any = None
        if progress is not None:
            self._subscriber = self._session.declare_subscriber(keys.epochs, _teller(progress))

    def close(self) -> None:
        """Close the session."""
        close_session(self._session)


def _listen(settings: Settings) -> tuple[str, zenoh.Session]:
    """Somebody else may take the free endpoint before we do; then another one is tried."""
    for _ in range(_TRIES - 1):
        endpoint = free_endpoint()
        try:
            return endpoint, open_session(listen=[endpoint], settings=settings, shared_memory=False)
        except TransportError:
            continue
    endpoint = free_endpoint()
    return endpoint, open_session(listen=[endpoint], settings=settings, shared_memory=False)


def _teller(progress: Callable[[int], None]) -> Callable[[zenoh.Sample], None]:
    def tell(sample: zenoh.Sample) -> None:
        try:
            epoch, _ = decode_value(sample.payload.to_bytes(), "epoch")
        except (SchemaError, ValueError, TypeError):
            return  # not from our world: a bar on a screen is all that it would have moved
        progress(epoch)

    return tell
