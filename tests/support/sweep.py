"""How much of what could be tried for hours a test tries: some in the suite, far more in `make sweep`."""

from __future__ import annotations

import os

SWEEP = bool(os.environ.get("HIERAX_SWEEP"))
"""Whether there is time for all of it."""


def examples(some: int, many: int) -> int:
    """How many are tried: of random ones in the suite, and in a sweep."""
    return many if SWEEP else some
