"""Who may say and hear what on which keys."""

from __future__ import annotations

import inspect
from itertools import product
from typing import Any

import pytest

from hierax.schemas.access import LATER, Access, Grants, of_launch, of_node, of_operator, of_reader
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import Keys

KEYS = Keys("live", "r1")
ACCESS = Access("world", {"world": ("world",), "both": ("high", "low")})
EVERYBODY = {
    "world": of_node(KEYS, "world", is_world=True),
    "low": of_node(KEYS, "low"),
    "launch": of_launch(KEYS),
    "operator": of_operator(KEYS),
    "reader": of_reader(KEYS),
}
PATTERNS = {"root", "everything", "inbox"}  # of others, none of their own


def kinds() -> dict[str, str]:
    """Of each kind of key one, as `low` has it where it is a node's."""
    given = {
        "kind": "obs",
        "sender": "low",
        "receiver": "high",
        "name": "low",
        "process": "low~3f",
        "instance": "low~3f",
    }
    found: dict[str, str] = {}
    for name, member in vars(Keys).items():
        if name.startswith("_") or name in (*PATTERNS, "deployment", "run"):
            continue
        if isinstance(member, property):
            found[name] = getattr(KEYS, name)
        elif callable(member):
            wanted = [each for each in inspect.signature(member).parameters if each != "self"]
            found[name] = getattr(KEYS, name)(*(given[each] for each in wanted))
    return found


def fits(pattern: str, key: str) -> bool:
    """Whether a pattern of Zenoh's, of those that are used, includes a key."""
    parts, names = pattern.split("/"), key.split("/")
    if parts[-1] == "**":
        parts = [*parts[:-1], *(["*"] * (len(names) - len(parts) + 1))]
    return len(parts) == len(names) and all(
        part in ("*", name) or (part.endswith("$*") and name.startswith(part[:-2]))
        for part, name in zip(parts, names, strict=True)
    )


def who(key: str, *fields: str) -> set[str]:
    """Who may do one of some things on a key."""
    return {
        name
        for name, grants in EVERYBODY.items()
        if any(fits(pattern, key) for field in fields for pattern in getattr(grants, field))
    }


WRITERS = {
    "edge": {"low"},
    "seen": {"low"},
    "alive": {"low"},
    "steps": {"low"},
    "words": {"low"},
    "control": {"world", "launch"},
    "epochs": {"world"},
    "roster": {"world"},
    "notes": {"launch"},
    "look": {"low", "launch"},  # which passes on what tools ask
    "launch": {"launch"},
    "changes": {"launch"},
}


def test_every_kind_of_key_has_its_writers_and_no_others() -> None:
    writers = {name: who(key, "says", "answers", "lives") for name, key in kinds().items()}
    assert writers == WRITERS  # a new kind of key has to be thought of in `hierax.schemas.access`


def test_who_only_looks_says_nothing_answers_nothing_and_asks_for_no_change() -> None:
    for name in ("reader", "operator"):
        grants = EVERYBODY[name]
        assert grants._replace(hears=(), asks=()) == Grants()
    assert who(KEYS.changes, "asks") == {"operator"}
    assert {*of_operator(KEYS).asks} - {*of_reader(KEYS).asks} == {KEYS.changes}
    assert all("reader" in who(key, "hears") for key in kinds().values())


def test_a_node_hears_what_is_for_it_alone() -> None:
    low = of_node(KEYS, "low")
    heard = {KEYS.edge(kind, "high", "low") for kind in ("obs", "task", "ctx")} | {KEYS.control("low~3f")}
    others = {KEYS.edge("obs", "low", "high"), KEYS.control("lower~3f"), KEYS.control("high~3f"), KEYS.words("high")}
    for key, wanted in (*product(heard, [True]), *product(others | {KEYS.epochs, KEYS.steps("low")}, [False])):
        assert any(fits(pattern, key) for pattern in low.hears) is wanted, key
    assert who(KEYS.words("low"), "hears") == {"world", "operator", "reader"}


def test_the_launch_hears_what_it_passes_on_and_nothing_that_nodes_say_to_one_another() -> None:
    heard = {name for name, key in kinds().items() if "launch" in who(key, "hears")}
    assert heard == {"epochs", "seen"}


def test_nodes_of_the_file_have_roles_of_their_own_and_others_one_together() -> None:
    roles = {ACCESS.role_of("world"), ACCESS.role_of("low"), ACCESS.role_of("high"), ACCESS.role_of("low", "both")}
    assert len(roles) == 4
    assert ACCESS.role_of("new") == ACCESS.role_of("new", "both") == LATER
    assert ACCESS.role_of("low", "other") == ACCESS.role_of("low")
    assert ACCESS.role_of("high", "both") == ACCESS.role_of("low", "both")
    assert Access("w", {"w": ("w",)}).role_of("x" * 128) == LATER
    assert max(map(len, roles)) <= 64  # what a certificate takes
    found = ACCESS.nodes_by_role()
    assert found[ACCESS.role_of("low", "both")] == ("high", "low")
    assert found[ACCESS.role_of("low")] == ("low",)


def test_access_is_read_as_it_is_told() -> None:
    assert Access.read(ACCESS.plain()) == ACCESS


@pytest.mark.parametrize(
    "plain",
    [
        None,
        {},
        {"world": "a/b", "processes": {}},
        {"world": "w", "processes": []},
        {"world": "w", "processes": {"a/b": ("w",)}},
        {"world": "w", "processes": {"p": "w"}},
        {"world": "w", "processes": {"p": ("**",)}},
    ],
)
def test_what_is_no_access(plain: Any) -> None:
    with pytest.raises(SchemaError, match=r"^access(\.processes\.\S+)?: expected "):
        Access.read(plain)
