"""Parameters of another type than the code's annotation says, in every shipped deployment."""

from __future__ import annotations

import typing
from collections.abc import Sequence
from typing import Optional

import pytest

from hierax.runtime.commands.main import main
from hierax.runtime.loading.arguments import wrong_argument


class Annotated:
    def __init__(
        self,
        flag: bool = False,
        count: int = 0,
        gain: float = 1.0,
        name: str | None = None,
        table: Optional[bool] = None,  # noqa: UP045 - users write it so, too
        items: Sequence[int] = (),
        what=None,  # type: ignore[no-untyped-def]
    ) -> None:
        pass


class Unresolved:
    def __init__(self, gain: Nowhere = 1) -> None:  # type: ignore[name-defined]  # noqa: F821
        pass


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"flag": "maybe"}, ("flag", "expected true or false, got 'maybe'")),
        ({"flag": 1}, ("flag", "expected true or false, got 1")),
        ({"count": 1.5}, ("count", "expected a whole number, got 1.5")),
        ({"count": True}, ("count", "expected a whole number, got true")),
        ({"gain": "1"}, ("gain", "expected a number, got '1'")),
        ({"gain": float("nan")}, ("gain", "expected a number, got .nan")),
        ({"gain": [1]}, ("gain", "expected a number, got a list")),
        ({"gain": None}, ("gain", "expected a number, got null")),
        ({"name": 3}, ("name", "expected text or null, got 3")),
        ({"table": "maybe"}, ("table", "expected true or false or null, got 'maybe'")),
        ({"flag": True, "count": 3, "gain": 2, "name": None, "table": None, "items": "x", "what": {}}, None),
        ({"gain": float("inf")}, None),
    ],
)
def test_parameters_have_the_types_of_their_annotations(given: dict[str, object], told: tuple[str, str] | None) -> None:
    assert wrong_argument(Annotated, given) == told


def test_annotations_that_have_no_hash_say_nothing() -> None:
    def made(weights: [float] = (), gain: typing.Annotated[float, {"unit": "m"}] = 1.0, count: int = 0) -> None:  # type: ignore[valid-type]
        pass

    assert wrong_argument(made, {"weights": [1.0], "gain": 2.0}) is None
    assert wrong_argument(made, {"weights": [1.0], "count": 0.5}) == ("count", "expected a whole number, got 0.5")


def test_annotations_that_cannot_be_resolved_say_nothing() -> None:
    assert wrong_argument(Unresolved, {"gain": "x"}) is None


@pytest.mark.parametrize(
    ("deployment", "setting", "told"),
    [
        (
            "tracking",
            "noise=.nan",
            "nodes.world.parameters.noise: expected a number, got .nan",
        ),
        ("tracking", "noise=.inf", "noise is inf; expected a number from 0 to 1000"),
        ("tracking", "table=maybe", "nodes.spatial.parameters.table: expected true or false or null, got 'maybe'"),
        ("tracking", "fps=.inf", "fps is inf; expected a positive number"),
        ("tracking", "cubes=2.5", "cubes: expected a whole number, got 2.5"),
        ("tracking", "physics=[]", "physics: expected true or false, got a list"),
        ("servo", "noise=.nan", "noise: expected a number, got .nan"),
        ("letters-image", "sigma=.nan", "sigma: expected a number, got .nan"),
        ("letters-image", "size=true", "size: expected a whole number, got true"),
        ("pick", "noise=.nan", "noise: expected a number, got .nan"),
        ("pick", "cubes=a", "cubes: expected a whole number, got 'a'"),
        ("causal-tree", "settle=a", "settle: expected a whole number or null, got 'a'"),
        ("causal-tree", "network.nodes=1000000000000", "at most 262144 nodes"),
        ("causal-tree", "draw.sets=1000000000000", "at most"),
        ("chain", "picture=-1", "size: expected a number of bytes from 0"),
        ("chain", "picture=1000000000000", "size: expected a number of bytes from 0"),
    ],
)
def test_shipped_deployments_say_what_they_expect(
    capsys: pytest.CaptureFixture[str], deployment: str, setting: str, told: str
) -> None:
    assert main(["validate", deployment, "--set", setting]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert told in error
    assert error.count("\n") == 1
