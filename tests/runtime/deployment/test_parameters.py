from __future__ import annotations

from itertools import pairwise

import pytest

from hierax.runtime.deployment.deployment import DeploymentError, Document
from hierax.runtime.deployment.parameters import substitute
from hierax.runtime.deployment.tree import read_tree


def document(text: str) -> Document:
    tree = read_tree(text, "f.yaml")
    return Document("f.yaml", tree.value, tree.lines)


@pytest.mark.parametrize(
    ("parameters", "value", "expected"),
    [
        ("{a: 1.5}", "${a}", 1.5),
        ("{a: false}", "${a}", False),
        ("{a: null}", "${a}", None),
        ("{a: [1, {b: 2}]}", "${a}", [1, {"b": 2}]),
        ("{a: 1.5}", "x${a}y", "x1.5y"),
        ("{a: true}", "x${a}", "xtrue"),
        ("{a: p, b: q}", "${a}/${b}", "p/q"),
        ("{a: p}", "$${a}", "${a}"),
        ("{a: p}", "$${a} ${a} $a $", "${a} p $a $"),
        ("{a: p, b: '${a}/x'}", "${b}", "p/x"),
        ("{a: [1], b: '${a}'}", "${b}", [1]),
        ("{a: '$${a}'}", "${a}", "${a}"),
        ("", "x", "x"),
    ],
)
def test_references_are_replaced(parameters: str, value: str, expected: object) -> None:
    root = substitute(document(f"parameters: {parameters}\nx: [{value!r}]\n"))
    assert root["x"] == [expected]
    assert type(root["x"][0]) is type(expected)


def test_origins_are_kept() -> None:
    source = document("parameters: {a: 1}\nx: {y: '${a}', z: 'a${a}'}\n")
    substitute(source)
    assert source.origins == {("x", "y"): "a"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parameters: {noise: 1}\nx:\n  y: ${nose}", "f.yaml:3: x.y: unknown parameter ${nose}; did you mean 'noise'?"),
        ("parameters: {noise: 1}\nx: ${}", "f.yaml:2: x: unknown parameter ${}; the parameters are noise"),
        ("x: ${a}", "f.yaml:1: x: unknown parameter ${a}: there are no parameters"),
        (
            "parameters:\n  a: ${b}\n  b: 1",
            "f.yaml:2: parameters.a: unknown parameter ${b}: there are no parameters above it",
        ),
        ("parameters: {c: 1, a: '${a}'}", "unknown parameter ${a}; the parameters above it are c"),
        ("parameters: {a: [1]}\nx: b${a}", "f.yaml:2: x: ${a} is a list and cannot stand within text"),
        ("parameters: {a: null}\nx: b${a}", "f.yaml:2: x: ${a} is null and cannot stand within text"),
        ("x: a${b", "f.yaml:1: x: '${' without its '}'; write '$${' for a plain '${'"),
        ("parameters: [1]", "f.yaml:1: parameters: expected a map from names to values, got a list"),
        ("parameters: {'a b': 1}", "f.yaml:1: parameters.a b: 'a b' is no parameter's name"),
    ],
)
def test_what_is_refused(text: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        substitute(document(text))
    assert message in str(caught.value)


@pytest.mark.parametrize("double", ["'${NAME}${NAME}'", "['${NAME}', '${NAME}']"])
def test_parameters_do_not_grow_without_bounds(double: str) -> None:
    names = [f"a{i}" for i in range(60)]
    lines = [f"  {name}: {double.replace('NAME', before)}" for before, name in pairwise(names)]
    with pytest.raises(DeploymentError, match="the parameters make the document too large"):
        substitute(document("parameters:\n  a0: 0123456789\n" + "\n".join(lines)))
