"""Which modules cover which code, and what is said of code that may not be loaded."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hierax.runtime.loading.allowance import ANYTHING, Allowance, NotAllowedError, is_target
from hierax.schemas.roster import Attach, Change, Detach, Reference, Replace, Roster, RosterEdge

SCENE, ARM, EYE = (Reference(f"robots.{name}:Node") for name in ("scene", "arm", "eye"))
SEEN = Reference("robots.arm:seen")
ROSTER = Roster(
    "world",
    {"world": SCENE, "arm": ARM, "eye": EYE},
    (RosterEdge("world", "arm", SEEN), RosterEdge("arm", "eye", SEEN, SEEN)),
)


def allowing(*modules: str) -> Allowance:
    return Allowance(modules)


@pytest.mark.parametrize(
    "change", [Attach({"lens": EYE}), Replace("arm", EYE), Replace("arm", ARM, (RosterEdge("a", "b", ARM, EYE),))]
)
def test_code_is_loaded_from_modules_that_are_allowed(change: Change) -> None:
    for allowed in (("robots.eye", "robots.arm"), ("robots.*",), ("robots.eye.*", "robots.arm")):
        Allowance(allowed).check_all(change)
    for allowed in (("robots",), ("robots.arm", "robots.ey", "robots.eye.more", "robot.*"), ()):
        with pytest.raises(NotAllowedError, match=r"add 'robots\.(eye|arm)' to 'modules' there"):
            Allowance(allowed).check_all(change)


def test_a_package_with_all_inside_it() -> None:
    allowing("robots.*").check("robots:Node", "nodes.arm.class")
    with pytest.raises(NotAllowedError, match="may not be loaded"):
        allowing("robots.*").check("robotsx.arm:Node", "nodes.arm.class")


def test_a_module_that_is_not_allowed_is_told_with_its_field() -> None:
    with pytest.raises(NotAllowedError) as caught:
        allowing("robots.*").check_all(replace(ROSTER, nodes={**ROSTER.nodes, "eye": Reference("os:system")}))
    assert str(caught.value) == (
        "nodes.eye.class: 'os:system' may not be loaded in this run: its deployment file neither names the module "
        "'os' nor allows it; add 'os' to 'modules' there and start the run anew"
    )
    for kind in ("sense", "task", "context"):
        attach = Attach({"lens": EYE}, (RosterEdge("arm", "lens", **{kind: SEEN}),))
        with pytest.raises(
            NotAllowedError, match=rf"^edges\.arm -> lens\.{kind}: 'robots\.arm:seen' may not be loaded"
        ):
            allowing("robots.eye").check_all(attach)
    allowing().check_all(Detach("arm"))


@pytest.mark.parametrize(
    "target",
    [
        "robots.arm:Arm.Inner",
        "robots.arm:X.observe.__builtins__.update",
        "robots.arm:",
        "robots..arm:X",
        "robots.arm:a b",
        "robots.arm:X\n",
        "robots.arm:X()",
        "robots/arm:X",
        "../robots:X",
        "x:y:z",
        ":X",
        "",
    ],
)
def test_a_target_is_one_name_in_a_module(target: str) -> None:
    assert not is_target(target)
    with pytest.raises(NotAllowedError) as caught:
        allowing("robots.*").check(target, "nodes.arm.class")
    assert str(caught.value).startswith("nodes.arm.class: expected 'package.module:name', one name in a module, got ")
    assert "\n" not in str(caught.value)


def test_what_a_node_loads_of_a_roster() -> None:
    strange = replace(ROSTER, nodes={**ROSTER.nodes, "world": Reference("os:World")})
    allowing("robots.*").check_part(strange, "eye")
    with pytest.raises(NotAllowedError, match=r"^nodes\.world\.class"):
        allowing("robots.*").check_part(strange, "world")
    with pytest.raises(NotAllowedError, match=r"^edges\.arm -> eye\.sense"):
        allowing("robots.eye").check_part(strange, "eye")


def test_more_modules() -> None:
    assert allowing("robots.eye").with_modules(["a.*", "robots.eye"]).modules == ("a.*", "robots.eye")


def test_who_trusts_has_anything_that_is_named_rightly() -> None:
    ANYTHING.check_all(replace(ROSTER, nodes={**ROSTER.nodes, "eye": Reference("os:Eye")}))
    with pytest.raises(NotAllowedError, match="one name in a module"):
        ANYTHING.check("os:path.join", "nodes.eye.class")
