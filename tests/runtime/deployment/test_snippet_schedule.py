from __future__ import annotations

from pathlib import Path

import pytest
from support.deployments import line_of, write

from hierax.runtime.commands.main import main
from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import read_attach, read_replace, read_schedule
from hierax.schemas.roster import Detach

THIRD = "nodes:\n  third: {class: support.toy_nodes:Summer}\nedges:\n  left -> third: {}\n"
LEFT = "nodes:\n  left: {class: support.toy_nodes:Summer}\n"


def test_changes_in_the_order_of_their_epochs(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    third, left = write(tmp_path, THIRD, "third.yaml"), write(tmp_path, LEFT, "a:b.yaml")
    texts = [
        "12:detach:left:cascade",
        f"4:replace:left:{left}",
        f" 4 :attach:{third}",
        "5:detach:third",
        f"5:attach:{third}",
        "20:attach:left",
        "21:detach:top.most",
    ]
    schedule = read_schedule(texts, deployment)
    assert [sorted(name for name, of in each.terms.items() if of.fails_alone) for each in schedule] == [
        [],
        ["third"],
        [],
        ["third"],
        [],
        ["left"],
        [],
    ]
    assert tuple(each[:2] for each in schedule) == (
        (4, read_replace(left, "left", deployment)),
        (4, read_attach(third, deployment)),
        (5, Detach("third")),
        (5, read_attach(third, deployment)),
        (12, Detach("left", cascade=True)),
        (20, read_attach("left", deployment)),
        (21, Detach("top.most")),
    )
    assert read_schedule([], deployment) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected EPOCH:attach:FILE, EPOCH:detach:NAME[:cascade], EPOCH:replace:NAME:FILE"),
        ("4", "expected EPOCH:attach:FILE, "),
        ("4:detatch:left", "there is no change 'detatch'; did you mean 'detach'?"),
        ("detach:left", "there is no change 'left'; expected one of attach, detach, replace"),
        ("four:detach:left", "expected the number of an epoch, from 1, got 'four'"),
        ("0:detach:left", "expected the number of an epoch, from 1, got '0'"),
        ("-1:detach:left", "expected the number of an epoch, from 1, got '-1'"),
        ("1_0:detach:left", "expected the number of an epoch, from 1, got '1_0'"),
        ("٣:detach:left", "expected the number of an epoch, from 1, got '٣'"),
        ("1" * 5000 + ":detach:left", "expected the number of an epoch, from 1, got '111"),
        ("4:detach", "expected EPOCH:detach:NAME[:cascade]"),
        ("4:detach:left:", "expected EPOCH:detach:NAME[:cascade]"),
        ("4:detach:left:all", "expected EPOCH:detach:NAME[:cascade]"),
        ("4:attach", "expected EPOCH:attach:FILE"),
        ("4:attach:", "expected EPOCH:attach:FILE"),
        ("4:replace:left", "expected EPOCH:replace:NAME:FILE"),
        ("4:replace::x.yaml", "expected EPOCH:replace:NAME:FILE"),
        ("4:detach:lefd", "cannot detach 'lefd': there is no such node; did you mean 'left'?"),
        ("4:detach:world", "cannot detach 'world': it is the world"),
        ("4:attach:left", "cannot attach 'left': there is a node 'left' already; replace it, or detach it first"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        read_schedule([text], read_deployment(write(tmp_path)))
    assert str(caught.value).startswith(f"--at {text}: {message}")
    assert "\n" not in str(caught.value)


def test_a_change_that_an_earlier_one_makes_impossible(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    third = write(tmp_path, THIRD, "third.yaml")
    message = "^--at 3:attach:.*: cannot attach 'third': edge left->third names 'left', and there is no such node"
    with pytest.raises(DeploymentError, match=message):
        read_schedule([f"3:attach:{third}", "2:detach:left"], deployment)


def test_a_module_that_the_deployment_does_not_allow(tmp_path: Path) -> None:
    other = write(tmp_path, THIRD.replace("support.toy_nodes", "os"), "other.yaml")
    message = r"nodes.third.class: 'os:Summer' may not be loaded in this run: .*; add 'os' to 'modules' there"
    with pytest.raises(DeploymentError, match=message):
        read_schedule([f"3:attach:{other}"], read_deployment(write(tmp_path)))
    allowed = read_deployment(write(tmp_path), ["modules=[os]"])
    assert len(read_schedule([f"3:attach:{other}"], allowed)) == 1


def test_a_wrong_snippet_has_its_own_place(tmp_path: Path) -> None:
    wrong = write(tmp_path, THIRD.replace("class", "clas"), "wrong.yaml")
    with pytest.raises(DeploymentError, match=r"wrong\.yaml:2: nodes\.third\.clas: unknown field"):
        read_schedule([f"3:attach:{wrong}"], read_deployment(write(tmp_path)))


@pytest.mark.parametrize(
    ("change", "name", "places"),
    [("2:attach", "third", ["other.yaml:2"]), ("2:replace:left", "left", ["toys.yaml:{left}", "other.yaml:2"])],
)
def test_an_error_of_a_scheduled_change_names_its_snippet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, name: str, places: list[str]
) -> None:
    text = THIRD if name == "third" else LEFT
    other = write(tmp_path, text.replace("Summer", "Sumer"), "other.yaml")
    file = write(tmp_path)
    assert main(["run", str(file), "--at", f"{change}:{other}"]) == 1
    where = " or ".join(f"{tmp_path}/{place.format(left=line_of('left: {class'))}" for place in places)
    assert f"error: {where}: nodes.{name}.class: " in capsys.readouterr().err
