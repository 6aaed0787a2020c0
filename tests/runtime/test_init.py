from __future__ import annotations

import importlib

import pytest

import hierax.runtime
from hierax.runtime.core.node import Node


def test_the_names_are_those_of_the_core() -> None:
    fresh = importlib.reload(hierax.runtime)
    assert fresh.Node is Node
    assert set(fresh.__all__) <= set(dir(fresh))
    assert all(getattr(fresh, name) is not None for name in fresh.__all__)


def test_another_name_is_none_of_them() -> None:
    with pytest.raises(AttributeError, match=r"module 'hierax\.runtime' has no attribute 'Nod'"):
        hierax.runtime.Nod  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(ImportError, match="cannot import name 'Nodes'"):
        from hierax.runtime import Nodes  # type: ignore[attr-defined]  # noqa: F401
