from __future__ import annotations

import pytest

from hierax.runtime.deployment.models import (
    SnippetModel,
    check_modules_pattern,
    check_target,
    field_meaning,
    field_names,
    split_edge,
)


@pytest.mark.parametrize("target", ["a:b", "a.b.c:D", "a_1:B", "_a:_b"])
def test_targets(target: str) -> None:
    assert check_target(target) == target


@pytest.mark.parametrize(
    "target", ["", "a", "a.b", "a:", ":b", "a:b:c", "a b:c", "a:b\n", "1a:b", "a..b:c", "a:b()", "../a:b", "a:b.c"]
)
def test_what_is_no_target(target: str) -> None:
    with pytest.raises(ValueError, match=r"expected 'package\.module:name', got"):
        check_target(target)


@pytest.mark.parametrize("pattern", ["a", "a.b_1", "a.*", "a.b.*"])
def test_modules(pattern: str) -> None:
    assert check_modules_pattern(pattern) == pattern


@pytest.mark.parametrize("pattern", ["", "*", ".*", "a.", "a*", "a.*.b", "a:b", "a.b\n", "../a", "a b"])
def test_what_is_no_module(pattern: str) -> None:
    with pytest.raises(ValueError, match=r"expected 'package\.module' or 'package\.\*', got"):
        check_modules_pattern(pattern)


def test_all_of_hierax_is_more_than_nodes() -> None:
    assert check_modules_pattern("hierax.nodes.*") == "hierax.nodes.*"
    with pytest.raises(ValueError, match=r"name the packages whose nodes may join, as 'hierax\.nodes\.\*'"):
        check_modules_pattern("hierax.*")


@pytest.mark.parametrize("edge", ["a -> b.c", "a->b.c", " a  ->b.c "])
def test_edges(edge: str) -> None:
    assert split_edge(edge) == ("a", "b.c")


@pytest.mark.parametrize("edge", ["a", "a ->", "-> b", "a - b", "a -> b -> c", "a b -> c", "a/b -> c"])
def test_what_is_no_edge(edge: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        split_edge(edge)


def test_fields_by_path() -> None:
    last = ("class", "parameters", "rate_hz", "budget_ms", "every", "offset", "scheduling")
    assert field_names(("nodes", "world"))[-7:] == last
    assert field_names(("nodes", "world"))[:-7] == field_names(("restart",))
    assert field_names((), SnippetModel) == ("nodes", "edges")
    assert field_names(("edges", "a -> b"), SnippetModel) == ("sense", "task", "context", "delay", "gather")
    assert field_names(("nodes",)) == ()
    assert field_names(("nodes", "world", "parameters")) == ()
    assert field_meaning(("world",)) == "which node is the external world"
    assert field_meaning(("nodes", "world", "restart_delay")).startswith("before a restart, doubled")
    assert field_meaning(("nodes", "world", "class")).startswith("module:name")
    assert field_meaning(("nodes", "world", "other")) == ""
