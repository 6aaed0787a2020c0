"""Zenoh's lists of who may say and hear what (`hierax.schemas.access`), by the names in certificates.

Each session has the same list, and holds all others to it: what comes from one (ingress), and what goes there (egress).
Zenoh reads it when a session opens, and never again.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hierax.schemas import access as roles
from hierax.schemas.access import Access, Grants
from hierax.schemas.keys import Keys

_PUT = ("put", "delete")
_ANSWER = ("declare_queryable", "reply")
_WATCH = ("declare_liveliness_subscriber", "liveliness_query")
_IN, _OUT = "ingress", "egress"

_GRANTED = (
    ("says", _IN, _PUT),
    ("hears", _IN, ("declare_subscriber",)),
    ("hears", _OUT, _PUT),
    ("asks", _IN, ("query",)),
    ("asks", _OUT, ("reply",)),
    ("asked", _OUT, ("query",)),
    ("answers", _IN, _ANSWER),
    ("lives", _IN, ("liveliness_token",)),
)
"""What has to pass so that somebody may do a thing: the field of `Grants`, which way, and Zenoh's messages."""

_FORBIDDEN = tuple(each for each in _GRANTED if each[0] in ("says", "hears", "answers", "lives"))
"""What a later node may not in the name of one that stands in the file."""

Rule = dict[str, Any]


def access_control(keys: Keys, access: Access) -> dict[str, Any]:
    """The list of a run's sessions."""
    shared = [
        # who lives is told to all, and what one listens to, answers or watches is no secret
        _rule("watch", _IN, _WATCH, [keys.alive("*")]),
        _rule("lives", _OUT, ("liveliness_token",), [keys.alive("*")]),
        _rule("declared", _OUT, ("declare_subscriber", "declare_queryable", *_WATCH), [keys.everything]),
    ]
    nodes = {name: roles.of_node(keys, name, is_world=name == access.world) for name in access.names}
    of_nodes = {name: list(_rules(f"node {name}", grants)) for name, grants in nodes.items()}
    later = [*_rules("later", roles.of_node(keys, "*")), *_forbidden(list(nodes.values()))]
    by_role = {
        roles.LAUNCH: list(_rules("launch", roles.of_launch(keys))),
        roles.READER: list(_rules("reader", roles.of_reader(keys))),
        roles.OPERATOR: list(_rules("operator", roles.of_operator(keys))),
        roles.LATER: later,
        **{role: [rule for name in names for rule in of_nodes[name]] for role, names in access.nodes_by_role().items()},
    }
    return _list({role: [*shared, *rules] for role, rules in by_role.items()})


def launch_alone() -> dict[str, Any]:
    """The list of a tool that links to nobody but a launch, which passes on what nodes say."""
    every = ("declare_subscriber", "query", "liveliness_token", *_PUT, *_ANSWER, *_WATCH)
    return _list({roles.LAUNCH: [_rule("all", way, every, ["hierax/**"]) for way in (_IN, _OUT)]})


def _rules(name: str, grants: Grants) -> Iterator[Rule]:
    for field, way, messages in _GRANTED:
        keys = getattr(grants, field)
        if keys:
            yield _rule(f"{name} {field}", way, messages, keys)


def _forbidden(nodes: Sequence[Grants]) -> Iterator[Rule]:
    for field, way, messages in _FORBIDDEN:
        keys = [key for grants in nodes for key in getattr(grants, field)]
        if keys:
            yield _rule(f"not {field}", way, messages, keys, "deny")


def _rule(name: str, way: str, messages: Sequence[str], keys: Sequence[str], permission: str = "allow") -> Rule:
    return {
        "id": f"{name}, {way}",
        "permission": permission,
        "flows": [way],
        "messages": list(messages),
        "key_exprs": list(keys),
    }


def _list(by_role: Mapping[str, Sequence[Rule]]) -> dict[str, Any]:
    rules = {rule["id"]: rule for each in by_role.values() for rule in each}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": list(rules.values()),
        "subjects": [{"id": role, "cert_common_names": [role]} for role in by_role],
        "policies": [
            {"id": role, "subjects": [role], "rules": [rule["id"] for rule in each]} for role, each in by_role.items()
        ],
    }
