"""pybullet without its greeting: it prints when it was built to the process's standard error, once, when imported."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from types import ModuleType


def load_pybullet() -> ModuleType:
    """The module; its import alone is silenced."""
    if "pybullet" in sys.modules:
        return sys.modules["pybullet"]
    try:
        kept = os.dup(2)
    except OSError:  # no standard error to keep clean
        return import_module("pybullet")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        return import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(nowhere)
        os.close(kept)
