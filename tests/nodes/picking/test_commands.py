"""Commands go down as names of policies, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from hierax.nodes.picking.commands import REST, command, handed_down, name_of
from hierax.nodes.picking.panda import gripper_down
from hierax.nodes.picking.tracker import spatial

POLICIES = spatial(0, 1).policies()
WANTED = command(gripper_down((0.5, -0.1, 0.2), 0.7, 0.1), 0.06, 0.25)


def test_a_policy_does_what_its_name_says() -> None:
    (action,) = POLICIES[name_of((WANTED,))](None)
    np.testing.assert_allclose(action["gripper"], WANTED["gripper"], atol=1e-12)
    assert (action["width"], action["speed"]) == (WANTED["width"], WANTED["speed"])


def test_a_command_handed_down_again_is_the_same_but_for_how_its_turn_is_rounded() -> None:
    name = name_of((WANTED,))
    (action,) = handed_down(POLICIES[name](None))
    (again,) = POLICIES[name_of((action,))](None)
    np.testing.assert_allclose(again["gripper"], action["gripper"], atol=1e-15)
    first, second = (each.split() for each in (name, name_of((again,))))
    assert (first[:4], first[-2:]) == (second[:4], second[-2:])
    np.testing.assert_allclose([*map(float, first[4:8])], [*map(float, second[4:8])], atol=1e-15)


def test_without_a_task_nothing_is_done() -> None:
    assert name_of(()) == REST
    assert POLICIES[REST](None) == ()
    assert list(POLICIES) == [REST]


@pytest.mark.parametrize("name", ["grab", "move", "move 1 2 3", "move a b c d e f g h i", "stay 1 2 3 4 5 6 7 8 9"])
def test_other_names_are_no_policies(name: str) -> None:
    with pytest.raises(KeyError):
        POLICIES[name]
