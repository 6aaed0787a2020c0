"""Async operators where no event loop runs."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Any


def wait_for(awaitable: Awaitable[Any]) -> Any:
    """Drive an async operator, in an event loop of its own."""
    import anyio

    async def wait() -> Any:
        return await awaitable

    return anyio.run(wait)
