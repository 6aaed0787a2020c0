from __future__ import annotations

import functools
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from support import toy_nodes
from support.deployments import write

from hierax.runtime.core.binding import Setting
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading import (
    LoadError,
    build_edge,
    build_hierarchy,
    build_node,
    build_probe,
    check_initial_belief,
    extend_import_path,
    load,
)
from hierax.schemas.roster import Reference, Roster, RosterEdge

TOYS = "support.toy_nodes"


def toy(name: str, **parameters: object) -> Reference:
    return Reference(f"{TOYS}:{name}", parameters)


def test_nodes_edges_and_probes_are_built() -> None:
    node = build_node(toy("Counter", step=4), "nodes.world")
    assert isinstance(node, toy_nodes.Counter)
    assert node.step == 4
    edge = build_edge(RosterEdge("a", "b", toy("seen"), toy("wanted"), toy("Scale", factor=2)))
    assert edge.sense is toy_nodes.seen
    assert edge.task is toy_nodes.wanted
    assert isinstance(edge.context, toy_nodes.Scale)
    probe = build_probe(toy("Keeper", file="x"), "probes[0]")
    assert isinstance(probe, toy_nodes.Keeper)
    assert probe.file == "x"


def test_a_functions_parameters_are_further_arguments() -> None:
    sense = build_edge(RosterEdge("a", "b", toy("seen", offset=3.0))).sense
    assert isinstance(sense, functools.partial)
    assert sense(1.0) == (4.0,)


def test_each_side_of_an_edge_builds_its_own_functions() -> None:
    edge = RosterEdge("a", "b", toy("seen"), toy("wanted"), toy("Scale", factor=2))
    lower, upper = build_edge(edge, "lower"), build_edge(edge, "upper")
    assert (lower.sense, lower.task, lower.context) == (toy_nodes.seen, None, None)
    assert upper.sense is None
    assert upper.task is toy_nodes.wanted
    assert upper.context is not None


def test_a_hierarchy_is_built(tmp_path: Path) -> None:
    hierarchy = build_hierarchy(read_deployment(write(tmp_path)).roster, Setting())
    assert hierarchy.order == ("world", "left", "top.most")


def test_a_name_inside_a_class() -> None:
    assert load(f"{TOYS}:Counter.predict", "x") is toy_nodes.Counter.predict


NODE_MISTAKES = [
    (toy("Countre"), "nodes.n.class", "there is no 'Countre' in module 'support.toy_nodes'; did you mean 'Counter'?"),
    (toy("Counter.predikt"), "nodes.n.class", "there is no 'predikt' in 'Counter'; did you mean 'predict'?"),
    (
        Reference("support.toy_node:X"),
        "nodes.n.class",
        "there is no module 'support.toy_node'; did you mean 'support.toy_nodes'?",
    ),
    (Reference("suport.toy_nodes:X"), "nodes.n.class", "there is no module 'suport'; did you mean 'support'?"),
    (
        Reference("zzqq:X"),
        "nodes.n.class",
        "there is no module 'zzqq'; it is looked for among the installed ones, beside the "
        "deployment file and in the current folder",
    ),
    (
        Reference("support.toy_nodes.more:X"),
        "nodes.n.class",
        "there is no module 'support.toy_nodes.more'; 'support.toy_nodes' is no package",
    ),
    (toy("GAIN"), "nodes.n.class", "expected a class, but support.toy_nodes:GAIN gives a int"),
    (toy("Path"), "nodes.n.class", "module 'support.toy_nodes' only imports 'Path'; name it as 'pathlib:Path'"),
    (
        Reference("hierax.runtime.loading:sys.exit"),
        "nodes.n.class",
        "'sys' in module 'hierax.runtime.loading' is a module itself",
    ),
    (toy("Keeper"), "nodes.n.class", "expected a class derived from Node, but support.toy_nodes:Keeper gives a Keeper"),
    (
        toy("Unfinished"),
        "nodes.n.class",
        "support.toy_nodes:Unfinished lacks initial_belief, more, which every subclass must define",
    ),
    (
        toy("Summer", weight=1),
        "nodes.n.parameters.weight",
        "support.toy_nodes:Summer has no such parameter; did you mean 'weights'?",
    ),
    (
        toy("Summer", zzz=1),
        "nodes.n.parameters.zzz",
        "support.toy_nodes:Summer has no such parameter; it takes scale, weights",
    ),
    (
        toy("NotCallable", a=1),
        "nodes.n.parameters.a",
        "support.toy_nodes:NotCallable has no such parameter; it takes none",
    ),
    (toy("Needy"), "nodes.n.parameters.model", "missing; support.toy_nodes:Needy needs it"),
    (
        toy("Needy", model="/nowhere/x.ply"),
        "nodes.n.parameters",
        "[Errno 2] No such file or directory: '/nowhere/x.ply'",
    ),
    (toy("Counter", step=0), "nodes.n.parameters.step", "step must be positive, got 0"),
    (toy("Broken"), "nodes.n.parameters", "support.toy_nodes:Broken raised KeyError: 'missing' ("),
]


@pytest.mark.parametrize(
    ("reference", "where", "what"), NODE_MISTAKES, ids=[f"{ref.target}-{where}" for ref, where, _ in NODE_MISTAKES]
)
def test_what_is_no_node(reference: Reference, where: str, what: str) -> None:
    with pytest.raises(LoadError) as caught:
        build_node(reference, "nodes.n")
    assert caught.value.where == where
    assert caught.value.what.startswith(what)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edge", "where", "what"),
    [
        (RosterEdge("a", "b", toy("sen")), "edges.a -> b.sense.function", "there is no 'sen' in module"),
        (
            RosterEdge("a", "b", None, toy("GAIN")),
            "edges.a -> b.task.function",
            "expected a function, or a class whose objects can be called, but support.toy_nodes:GAIN gives a int",
        ),
        (
            RosterEdge("a", "b", None, None, toy("NotCallable")),
            "edges.a -> b.context.function",
            "expected a function, or a "
            "class whose objects can be called, but support.toy_nodes:NotCallable gives a NotCallable",
        ),
        (
            RosterEdge("a", "b", toy("seen", ofset=1)),
            "edges.a -> b.sense.parameters.ofset",
            "support.toy_nodes:seen has no such parameter; did you mean 'offset'?",
        ),
        (
            RosterEdge("a", "b", None, None, toy("Scale")),
            "edges.a -> b.context.parameters.factor",
            "missing; support.toy_nodes:Scale needs it",
        ),
    ],
)
def test_what_is_no_edge(edge: RosterEdge, where: str, what: str) -> None:
    with pytest.raises(LoadError) as caught:
        build_edge(edge)
    assert caught.value.where == where
    assert caught.value.what.startswith(what)


def test_what_is_no_probe() -> None:
    with pytest.raises(
        LoadError, match=r"^probes\[0\]\.class: expected a class derived from Probe, but .* gives a Summer$"
    ):
        build_probe(toy("Summer"), "probes[0]")


@pytest.mark.parametrize(
    ("world", "upper", "edge", "message"),
    [
        ("Summer", "Summer", "seen", "nodes.w.class: the world's class must derive from World, Summer does not"),
        (
            "Counter",
            "Misshapen",
            "seen",
            "nodes.n: observe must take (observations, belief) and, if it likes, tick; it takes "
            "(observations: 'Elements', belief: 'Value', more: 'Value') -> 'Value'",
        ),
        ("Counter", "Summer", "two", "edges.w -> n: sense must take (belief) and, if it likes, tick; it takes "),
    ],
)
def test_what_is_no_hierarchy(world: str, upper: str, edge: str, message: str) -> None:
    roster = Roster("w", {"w": toy(world), "n": toy(upper)}, (RosterEdge("w", "n", toy(edge)),))
    with pytest.raises(LoadError) as caught:
        build_hierarchy(roster, Setting())
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Unsendable", "nodes.n: the initial belief is no value: "),
        ("Faulty", "nodes.n: initial_belief raised RuntimeError: no simulator ("),
    ],
)
def test_an_initial_belief_must_be_had_and_travel(name: str, message: str) -> None:
    with pytest.raises(LoadError) as caught:
        check_initial_belief("n", build_node(toy(name), "nodes.n"))
    assert str(caught.value).startswith(message)


MODULES = {
    "faulty": ("1 / 0", "importing 'MODULE' raised ZeroDivisionError: division by zero ("),
    "misspelt": ("def f(:\n    pass", "importing 'MODULE' raised SyntaxError: "),
    "needy": ("import zzqq_not_there", "module 'MODULE' needs module 'zzqq_not_there', which is not installed"),
    "leaving": ("raise SystemExit(3)", "importing 'MODULE' raised SystemExit: 3 ("),
}


@pytest.mark.parametrize("name", MODULES)
def test_a_module_that_cannot_be_imported(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, message = MODULES[name]
    (tmp_path / f"hierax_test_{name}.py").write_text(text)
    monkeypatch.setattr(sys, "path", [*sys.path])
    extend_import_path([str(tmp_path)])
    with pytest.raises(LoadError) as caught:
        load(f"hierax_test_{name}:X", "nodes.n.class")
    assert str(caught.value).startswith("nodes.n.class: " + message.replace("MODULE", f"hierax_test_{name}"))
    assert "\n" not in str(caught.value)


def test_folders_come_behind_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    before = list(sys.path)
    extend_import_path([str(tmp_path), before[0], str(tmp_path)])
    assert sys.path == [*before, str(tmp_path)]


def test_node_processes_need_nothing_heavy() -> None:
    script = """
        import sys
        import hierax.runtime.loading, hierax.runtime.deployment
        heavy = {"pydantic", "yaml", "typer", "rich", "zenoh", "pybullet", "cv2"} & set(sys.modules)
        print(sorted(heavy))
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
