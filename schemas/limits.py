"""Bounds on everything that arrives from outside.

A message that breaks one of them is refused with a `SchemaError` before memory
in proportion to its claims is taken.
"""

from __future__ import annotations

MAX_MESSAGE_BYTES = 256 * 1024 * 1024
MAX_ARRAY_BYTES = 256 * 1024 * 1024
MAX_ARRAY_NDIM = 16
MAX_DEPTH = 64
MAX_ITEMS = 1 << 20
"""Entries of one array or map."""

MAX_CONTAINERS = 1 << 18
"""Arrays and maps in one value: an empty map of one byte takes some ninety of memory."""

MAX_NAME_CHARS = 128
MAX_EXTENSIONS = 64

LARGE_ARRAY_BYTES = 16 * 1024
"""Arrays from this size up travel behind the payload, where they can be read in place."""
