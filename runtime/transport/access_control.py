"""Zenoh's lists of who may say and hear what (`hierax.schemas.access`), by the names in certificates.

Each session has the same list, and holds all others to it: what comes from one (ingress), and what goes there (egress).
Zenoh reads it when a session opens, and never again.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

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

_OWN = ("says", "hears", "answers", "lives")  # what is each node's alone


class Rule(NamedTuple):
    """Messages of Zenoh's that pass in one direction on some keys, or do not."""

    way: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]
    permission: str = "allow"


def access_control(keys: Keys, access: Access) -> dict[str, Any]:
    """The list of a run's sessions."""
    nodes = {name: roles.of_node(keys, name, is_world=name == access.world) for name in access.names}
    of_nodes = {name: list(_rules(grants)) for name, grants in nodes.items()}
    shared = [
        # who lives is told to all, and what one listens to, answers or watches is no secret
        Rule(_IN, _WATCH, (keys.alive("*"),)),
        Rule(_OUT, ("liveliness_token",), (keys.alive("*"),)),
        Rule(_OUT, ("declare_subscriber", "declare_queryable", *_WATCH), (keys.everything,)),
    ]
    by_role = {
        roles.LAUNCH: _rules(roles.of_launch(keys)),
        roles.READER: _rules(roles.of_reader(keys)),
        roles.OPERATOR: _rules(roles.of_operator(keys)),
        roles.LATER: [*_rules(roles.of_node(keys, "*")), *_denied(nodes.values())],
        **{role: [rule for name in names for rule in of_nodes[name]] for role, names in access.nodes_by_role().items()},
    }
    return _list({role: [*shared, *rules] for role, rules in by_role.items()})


def launch_alone() -> dict[str, Any]:
    """The list of a tool that links to nobody but a launch, which passes on what nodes say."""
    every = ("declare_subscriber", "query", "liveliness_token", *_PUT, *_ANSWER, *_WATCH)
    return _list({roles.LAUNCH: [Rule(way, every, ("hierax/**",)) for way in (_IN, _OUT)]})


def _rules(grants: Grants) -> Iterator[Rule]:
    for field, way, messages in _GRANTED:
        keys = getattr(grants, field)
        if keys:
            yield Rule(way, messages, keys)


def _denied(nodes: Collection[Grants]) -> Iterator[Rule]:
    """What a later node may not, as it is for one that stands in the file."""
    for field, way, messages in _GRANTED:
        if field in _OWN:
            yield Rule(way, messages, tuple(key for grants in nodes for key in getattr(grants, field)), "deny")


def _list(by_role: Mapping[str, Sequence[Rule]]) -> dict[str, Any]:
    """Each rule once: Zenoh takes long to read them."""
    numbers = {rule: str(number) for number, rule in enumerate(dict.fromkeys(chain.from_iterable(by_role.values())))}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": each,
                "permission": rule.permission,
                "flows": [rule.way],
                "messages": rule.messages,
                "key_exprs": rule.keys,
            }
            for rule, each in numbers.items()
        ],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in by_role],
        "policies": [
            {"id": role, "subjects": [role], "rules": [numbers[rule] for rule in rules]}
            for role, rules in by_role.items()
        ],
    }
