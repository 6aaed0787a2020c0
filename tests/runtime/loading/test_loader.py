from __future__ import annotations

import functools
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support import toy_nodes
from support.deployments import write

from hierax.runtime.core.binding import OperatorSetting
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.loading.allowance import Allowance, NotAllowedError
from hierax.runtime.loading.loader import (
    LoadError,
    build_edge,
    build_hierarchy,
    build_node,
    build_probe,
    check_initial_belief,
    extend_import_path,
    load,
    load_function,
)
from hierax.runtime.loading.node_loader import NodeLoader
from hierax.schemas.roster import Reference, Roster, RosterEdge

TOYS = "support.toy_nodes"
TRIED = Allowance(("support.*", "suport.*", "zzqq", "hierax.runtime.loading.loader"))


def toy(name: str, **parameters: object) -> Reference:
    return Reference(f"{TOYS}:{name}", parameters)


def test_nodes_edges_and_probes_are_built() -> None:
    node = build_node(toy("Counter", step=4), "nodes.world", TRIED)
    assert isinstance(node, toy_nodes.Counter)
    assert node.step == 4
    edge = build_edge(RosterEdge("a", "b", toy("seen"), toy("wanted"), toy("Scale", factor=2)), TRIED)
    assert edge.sense is toy_nodes.seen
    assert edge.task is toy_nodes.wanted
    assert isinstance(edge.context, toy_nodes.Scale)
    probe = build_probe(toy("Keeper", file="x"), "probes[0]", TRIED)
    assert isinstance(probe, toy_nodes.Keeper)
    assert probe.file == "x"


def test_a_functions_parameters_are_further_arguments() -> None:
    sense = build_edge(RosterEdge("a", "b", toy("seen", offset=3.0)), TRIED).sense
    assert isinstance(sense, functools.partial)
    assert sense(1.0) == (4.0,)


def test_each_side_of_an_edge_builds_its_own_functions() -> None:
    edge = RosterEdge("a", "b", toy("seen"), toy("wanted"), toy("Scale", factor=2))
    lower, upper = build_edge(edge, TRIED, "lower"), build_edge(edge, TRIED, "upper")
    assert (lower.sense, lower.task, lower.context) == (toy_nodes.seen, None, None)
    assert upper.sense is None
    assert upper.task is toy_nodes.wanted
    assert upper.context is not None


def test_a_hierarchy_is_built(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    hierarchy = build_hierarchy(deployment.roster, OperatorSetting(), deployment.allowance)
    assert hierarchy.order == ("world", "left", "top.most")


NODE_MISTAKES = [
    (toy("Countre"), "nodes.n.class", "there is no 'Countre' in module 'support.toy_nodes'; did you mean 'Counter'?"),
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
    (toy("GAIN"), "nodes.n.class", "expected a class derived from Node, but support.toy_nodes:GAIN is a int"),
    (toy("Path"), "nodes.n.class", "module 'support.toy_nodes' only imports 'Path'; name it as 'pathlib:Path'"),
    (
        Reference("hierax.runtime.loading.loader:sys"),
        "nodes.n.class",
        "'sys' in module 'hierax.runtime.loading.loader' is a module itself",
    ),
    (toy("Keeper"), "nodes.n.class", "expected a class derived from Node, but support.toy_nodes:Keeper is a Probe"),
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
    (toy("Needy"), "nodes.n.parameters.model", "missing; support.toy_nodes:Needy needs it"),
    (
        toy("Needy", model="/nowhere/x.ply"),
        "nodes.n.parameters",
        "[Errno 2] No such file or directory: '/nowhere/x.ply'",
    ),
    (toy("Counter", step=0), "nodes.n.parameters.step", "step must be positive, got 0"),
    (toy("Broken"), "nodes.n.parameters", "support.toy_nodes:Broken raised KeyError: 'missing' ("),
    (toy("Leaving"), "nodes.n.parameters", "support.toy_nodes:Leaving raised SystemExit: 0 ("),
]


@pytest.mark.parametrize(
    ("reference", "where", "what"), NODE_MISTAKES, ids=[f"{ref.target}-{where}" for ref, where, _ in NODE_MISTAKES]
)
def test_what_is_no_node(reference: Reference, where: str, what: str) -> None:
    with pytest.raises(LoadError) as caught:
        build_node(reference, "nodes.n", TRIED)
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
            "expected a function, or a class whose objects can be called, but support.toy_nodes:GAIN is a int",
        ),
        (
            RosterEdge("a", "b", None, None, toy("NotCallable")),
            "edges.a -> b.context.function",
            "expected a function, or a "
            "class whose objects can be called, but support.toy_nodes:NotCallable is another class",
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
        build_edge(edge, TRIED)
    assert caught.value.where == where
    assert caught.value.what.startswith(what)


def test_what_is_no_probe() -> None:
    with pytest.raises(LoadError, match=r"^probes\[0\]\.class: expected a class derived from Probe, but .* is a Node$"):
        build_probe(toy("Summer"), "probes[0]", TRIED)


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
        build_hierarchy(roster, OperatorSetting(), TRIED)
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
        check_initial_belief("n", build_node(toy(name), "nodes.n", TRIED))
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
        load(f"hierax_test_{name}:X", "nodes.n.class", Allowance((f"hierax_test_{name}",)))
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
        import hierax.runtime.loading.loader, hierax.runtime.deployment
        heavy = {"pydantic", "yaml", "typer", "rich", "zenoh", "pybullet", "cv2"} & set(sys.modules)
        print(sorted(heavy))
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


# --- what may not be loaded is not imported, and what is of another kind is not called

TREACHEROUS = """
from pathlib import Path

from hierax.runtime import Node, Probe, World

CALLED = Path(__file__).with_name("called")


class Writer:
    def __init__(self, *arguments, **options):
        CALLED.write_text("a class of no kind was called")

    def write(self, belief):
        return ()


class Result(Probe):
    def __init__(self):
        CALLED.write_text("a probe was made")

    def record(self, step):
        return


class Outer(Node):
    class Inner(Node):
        def __init__(self):
            CALLED.write_text("a class in a class was called")

        def initial_belief(self):
            return None

    def __init__(self):
        CALLED.write_text("a node was made in the place of something else")

    def initial_belief(self):
        return None

    def __call__(self, belief):
        return ()


class Wide:
    def __init__(self):
        CALLED.write_text("an edge function that takes too much was made")

    def __call__(self, belief, more):
        return ()


def silent():
    CALLED.write_text("a function that does not say that it makes nodes was called")


def other() -> Writer:
    return Writer()


def sure() -> Outer | World:
    CALLED.write_text("it was to be called")
    return Outer()


written = Writer.write
"""


@pytest.fixture
def treacherous(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A module whose code leaves a file when it is called."""
    (tmp_path / "hierax_test_treacherous.py").write_text(TREACHEROUS)
    monkeypatch.setattr(sys, "path", [*sys.path])
    extend_import_path([str(tmp_path)])
    yield tmp_path / "called"
    sys.modules.pop("hierax_test_treacherous", None)


def treachery(name: str) -> Reference:
    return Reference(f"hierax_test_treacherous:{name}")


def test_what_may_not_be_loaded_is_not_imported(treacherous: Path) -> None:
    module = treacherous.with_name("hierax_test_unnamed.py")
    module.write_text("from pathlib import Path\nPath(__file__).with_name('called').touch()\n")
    reference = Reference("hierax_test_unnamed:X")
    roster = Roster("w", {"w": toy("Counter"), "n": toy("Summer")}, (RosterEdge("w", "n", reference),))
    for build in (
        lambda: build_node(reference, "nodes.n", TRIED),
        lambda: build_probe(reference, "probes[0]", TRIED),
        lambda: build_edge(RosterEdge("a", "b", reference), TRIED),
        lambda: build_hierarchy(roster, OperatorSetting(), TRIED),
        lambda: NodeLoader("n", OperatorSetting(), TRIED).wiring(roster),
        lambda: NodeLoader("w", OperatorSetting(), TRIED).wiring(replace(roster, edges=(), nodes={"w": reference})),
        lambda: load_function("hierax_test_unnamed:X", "view.show", TRIED),
    ):
        with pytest.raises(NotAllowedError, match="'hierax_test_unnamed:X' may not be loaded in this run"):
            build()
    assert "hierax_test_unnamed" not in sys.modules
    assert not treacherous.exists()


@pytest.mark.parametrize("name", ["Writer", "Result", "Outer.Inner", "Wide", "silent", "other", "written", "CALLED"])
def test_what_is_no_node_is_not_called(name: str, treacherous: Path) -> None:
    with pytest.raises(HieraxError, match=r"^nodes\.n\.class: expected "):
        build_node(treachery(name), "nodes.n", Allowance(("hierax_test_treacherous",)))
    assert not treacherous.exists()


@pytest.mark.parametrize("name", ["Writer", "Result", "Outer", "Wide", "silent", "Outer.Inner", "Writer.write"])
def test_what_is_no_edge_function_is_not_called(name: str, treacherous: Path) -> None:
    with pytest.raises(HieraxError, match=r"^edges\.a -> b"):
        build_edge(RosterEdge("a", "b", treachery(name)), Allowance(("hierax_test_treacherous",)))
    assert not treacherous.exists()


@pytest.mark.parametrize("name", ["Writer", "Outer", "silent", "sure"])
def test_what_is_no_probe_is_not_called(name: str, treacherous: Path) -> None:
    with pytest.raises(LoadError, match=r"^probes\[0\]\.class: expected a class derived from Probe, but "):
        build_probe(treachery(name), "probes[0]", Allowance(("hierax_test_treacherous",)))
    assert not treacherous.exists()


def test_a_function_that_says_so_makes_a_node(treacherous: Path) -> None:
    allowed = Allowance(("hierax_test_treacherous",))
    with pytest.raises(LoadError, match=r"expected a class derived from World, but hierax_test_treacherous:sure is a"):
        build_node(treachery("sure"), "nodes.n", allowed, is_world=True)
    assert not treacherous.exists()
    assert type(build_node(treachery("sure"), "nodes.n", allowed)).__name__ == "Outer"


@pytest.mark.parametrize("modules", [("hierax.nodes.tracking.evaluation.probes",), ("hierax.nodes.*",)])
def test_a_results_file_is_no_node(modules: tuple[str, ...], tmp_path: Path) -> None:
    victim = tmp_path / "victim.txt"
    victim.write_text("precious")
    parameters = {"path": str(victim), "scene_id": 0}
    with pytest.raises(LoadError, match=r"^nodes\.n\.class: "):
        build_node(
            Reference("hierax.nodes.tracking.evaluation.probes:ResultsFile", parameters), "nodes.n", Allowance(modules)
        )
    assert victim.read_text() == "precious"


def test_what_a_module_only_imports_is_allowed_by_the_module_that_defines_it(tmp_path: Path, treacherous: Path) -> None:
    (tmp_path / "hierax_test_importing.py").write_text("from hierax_test_treacherous import Outer\n")
    reference = Reference("hierax_test_importing:Outer")
    with pytest.raises(LoadError, match="only imports 'Outer'; name it as 'hierax_test_treacherous:Outer'"):
        build_node(reference, "nodes.n", Allowance(("hierax_test_importing",)))
    assert not treacherous.exists()
    build_node(reference, "nodes.n", Allowance(("hierax_test_importing", "hierax_test_treacherous")))
    inside = Reference("hierax.nodes.letters:symbol_seen", {"letter": 1})  # a package offers what is inside it
    assert build_edge(RosterEdge("a", "b", inside), Allowance(("hierax.nodes.letters",))).sense is not None


TWINS = Allowance(("twin_of_two", "alone_in_b"))


def test_a_module_of_another_deployment_is_not_taken_for_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        (folder / "twin_of_two.py").write_text(f"class Made:\n    name = {folder.name!r}\n", encoding="utf-8")
    (folders[1] / "alone_in_b.py").write_text("class Made:\n    name = 'b'\n", encoding="utf-8")
    try:
        extend_import_path([str(folders[0])])
        assert load("twin_of_two:Made", "nodes.x", TWINS).name == "a"
        extend_import_path([str(folders[1])])
        assert load("alone_in_b:Made", "nodes.x", TWINS).name == "b"
        with pytest.raises(LoadError, match=r"module 'twin_of_two' of another deployment, .*a/twin_of_two\.py"):
            load("twin_of_two:Made", "nodes.x", TWINS)
        extend_import_path([str(folders[0])])
        assert load("twin_of_two:Made", "nodes.x", TWINS).name == "a"
    finally:
        sys.modules.pop("twin_of_two", None)
        sys.modules.pop("alone_in_b", None)
