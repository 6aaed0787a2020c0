"""What the nodes of one process share: a session of Zenoh, the way from one to another, and the pipe's turns."""

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from hierax.runtime.launch.doors import is_free
from hierax.runtime.launch.frames import NodeOrder
from hierax.runtime.transport.access_control import access_control
from hierax.runtime.transport.shared_process import Neighbours
from hierax.runtime.transport.zenoh_session import (
    LINGER_S,
    Links,
    await_links,
    close_session,
    door_at,
    endpoint_at,
    knocking_at,
    log_links,
    open_session,
)
from hierax.schemas.keys import Keys


class ProcessHome:
    """A process of so many nodes, each with a thread of its own. One node alone owns the session that it opens."""

    def __init__(self, nodes: int) -> None:
        self.beside = Neighbours() if nodes > 1 else None  # where nodes of the process take messages from
        self.saying = threading.Lock()  # held by who writes to the supervisor
        self.loading = threading.Lock()  # held by who imports: two threads in a circle of modules would see half of one
        self._opening = threading.Lock()
        self._session: Any = None

    @property
    def declaring(self) -> AbstractContextManager[Any]:
        """Held by who declares something in the session, or takes it back."""
        return nullcontext() if self.beside is None else self.beside.declaring

    def session(self, order: NodeOrder) -> Any:
        """The session, opened by who comes first. Raises `TransportError` as `open_session` does."""
        with self._opening:
            if self._session is None:
                self._session = _opened(order)
            return self._session

    def renew(self, order: NodeOrder, move: Callable[[Any], bool]) -> bool:
        """Go on in another session, opened by an order with a certificate that is new. `move` has all nodes use that,
        and says, as does this, whether they do. Raises `TransportError` as `open_session` does."""
        before, session = self._session, _opened(order)
        await_links(session, before)
        with self._opening:
            self._session = session
        if not move(session):
            return False  # some use the one before
        time.sleep(LINGER_S)
        close_session(before)
        return True

    def close(self) -> None:
        """Close the session, when no node uses it any more."""
        if self._session is not None and self.beside is not None:
            close_session(self._session)


def _opened(order: NodeOrder) -> Any:
    log_links()
    access = None
    if order.access is not None:
        access = access_control(Keys(order.deployment, order.run), order.access)
    listen, connect = [endpoint_at(order.host, order.secret)], [order.hub]
    has_door = bool(order.door) and is_free(order.door)
    links: Links = "told" if has_door else "all"
    if has_door:
        listen.append(door_at(order.door))
        connect += map(knocking_at, order.doors)
    return open_session(
        listen,
        connect,
        order.settings,
        links=links,
        low_latency=order.low_latency,
        secret=order.secret,
        access=access,
    )
