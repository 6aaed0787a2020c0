from __future__ import annotations

import json
import random
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.deployments import TOYS, line_of, replaced, write
from support.sweep import examples

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.deployment import ProcessTerms
from hierax.runtime.deployment.read import read_deployment
from hierax.schemas.roster import ProbeSpec, Reference, Roster, RosterEdge

SEEN = Reference("support.toy_nodes:seen")


def test_a_deployment_in_full(tmp_path: Path) -> None:
    path = write(tmp_path)
    deployment = read_deployment(path)
    assert (deployment.path, deployment.name, deployment.epochs) == (path, "toys", 3)
    assert deployment.description == "a counter and two that sum"
    assert deployment.start_timeout_s == 30.0
    assert deployment.zenoh is None
    assert deployment.import_paths == (str(tmp_path), str(Path.cwd()))
    assert deployment.probes == (ProbeSpec("left", Reference("support.toy_nodes:Keeper", {"file": "2.csv"})),)
    assert deployment.roster == Roster(
        "world",
        {
            "world": Reference("support.toy_nodes:Counter", {"step": 2}),
            "left": Reference("support.toy_nodes:Summer"),
            "top.most": Reference("support.toy_nodes:Summer", {"scale": 0.5, "weights": (1, 2.5)}),
        },
        (
            RosterEdge("left", "top.most", SEEN, None, Reference("support.toy_nodes:Scale", {"factor": 2})),
            RosterEdge("world", "left", SEEN),
            RosterEdge("world", "top.most", Reference("support.toy_nodes:seen", {"offset": 1})),
        ),
    )


def test_the_least_that_is_needed(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path, "hierarchy: one\nworld: w\nnodes:\n  w: {class: a:b}\n"))
    assert (deployment.epochs, deployment.description, deployment.probes) == (None, "", ())
    assert deployment.roster == Roster("w", {"w": Reference("a:b")}, ())


def test_what_is_given_as_nothing_is_as_left_out(tmp_path: Path) -> None:
    bare = "hierarchy: one\nworld: w\nnodes:\n  w: {class: a:b}\n"
    nothing = ("parameters", "epochs", "edges", "probes", "zenoh", "restart", "modules")
    full = "".join(f"{name}:\n" for name in nothing) + f"{bare[:-2]}, parameters: }}\n"
    assert read_deployment(write(tmp_path, bare)) == read_deployment(write(tmp_path, full))


def test_overrides(tmp_path: Path) -> None:
    deployment = read_deployment(
        write(tmp_path), ["step=5", "context=false", "epochs=9", "nodes.left.parameters.scale=7", "world=world"]
    )
    assert deployment.roster.nodes["world"].parameters == {"step": 5}
    assert deployment.roster.nodes["left"].parameters == {"scale": 7}
    assert deployment.roster.edges[0].context is None
    assert deployment.epochs == 9
    assert deployment.probes[0].reference.parameters == {"file": "5.csv"}


def test_probes_and_order_are_no_part_of_the_content(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    without = read_deployment(write(tmp_path), ["probes=[]"])
    swapped = TOYS.replace("  left: {class: support.toy_nodes:Summer}\n", "")
    swapped = swapped.replace("nodes:\n", "nodes:\n  left: {class: support.toy_nodes:Summer}\n", 1)
    assert list(read_deployment(write(tmp_path, swapped)).roster.nodes) != list(deployment.roster.nodes)
    assert without.roster.content_hash() == deployment.roster.content_hash()
    assert read_deployment(write(tmp_path, swapped)).roster.content_hash() == deployment.roster.content_hash()
    assert read_deployment(write(tmp_path), ["step=3"]).roster.content_hash() != deployment.roster.content_hash()


def test_what_is_not_said_about_recovery(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path))
    assert deployment.restart == ProcessTerms()
    assert deployment.terms == dict.fromkeys(("world", "left", "top.most"), ProcessTerms())
    assert (deployment.durability, deployment.on_uncertain_act) == ("process", "repeat")
    assert deployment.epoch_deadline_s == 60.0


RECOVERY = [
    "durability=host",
    "on_uncertain_act=skip",
    "epoch_deadline_s=null",
    "modules=[robots.arm]",
    "restart={max_restarts: 0, on_loss: stop, restart_window: null, rejoin_timeout: 2}",
    "nodes.left.on_loss=detach",
    "nodes.left.restart_policy=always",
    "nodes.left.restart_delay=8",
    "nodes.world.max_restart_delay=0.5",
]


def test_what_is_said_about_recovery(tmp_path: Path) -> None:
    deployment = read_deployment(write(tmp_path), RECOVERY)
    said = ProcessTerms(max_restarts=0, on_loss="stop", restart_window_s=None, rejoin_timeout_s=2)
    assert deployment.restart == deployment.terms["top.most"] == said
    assert deployment.terms["world"] == replace(said, max_restart_delay_s=0.5)
    assert deployment.terms["left"] == replace(
        said, restart_policy="always", on_loss="detach", restart_delay_s=8, max_restart_delay_s=8
    )
    assert (deployment.durability, deployment.on_uncertain_act) == ("host", "skip")
    assert deployment.epoch_deadline_s is None


def test_the_longest_delay_is_no_shorter_than_the_first(tmp_path: Path) -> None:
    settings = ["restart.max_restart_delay=2", "nodes.left.restart_delay=3"]
    restarts = read_deployment(write(tmp_path), settings).terms
    assert [restarts[name].max_restart_delay_s for name in ("left", "world")] == [3, 2]
    assert read_deployment(write(tmp_path), ["restart.restart_delay=9"]).restart.max_restart_delay_s == 9


def test_recovery_is_no_part_of_the_content(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert read_deployment(path, RECOVERY).roster == read_deployment(path).roster


def test_modules_are_what_the_file_names_and_lists(tmp_path: Path) -> None:
    path = write(tmp_path, replaced("    task: null", "    task: {function: 'tasks.off:f', enabled: false}"))
    assert read_deployment(path).modules == ("support.toy_nodes", "tasks.off")
    listed = ["modules=[support.toy_nodes, robots.*, a]", "probes.0.class=probes.of:Mine"]
    expected = ("a", "probes.of", "robots.*", "support.toy_nodes", "tasks.off")
    assert read_deployment(path, listed).modules == expected


def test_zenohs_own_settings(tmp_path: Path) -> None:
    (tmp_path / "zenoh.json5").write_text("{}")
    path = write(tmp_path)
    assert read_deployment(path, ["zenoh={listen: {endpoints: [x]}}"]).zenoh == {"listen": {"endpoints": ["x"]}}
    assert read_deployment(path, ["zenoh='{mode: \"peer\"}'"]).zenoh == '{mode: "peer"}'
    assert read_deployment(path, ["zenoh=zenoh.json5"]).zenoh == str(tmp_path / "zenoh.json5")


def test_low_latency(tmp_path: Path) -> None:
    assert not read_deployment(write(tmp_path)).low_latency
    assert read_deployment(write(tmp_path), ["low_latency=true"]).low_latency


MISTAKES = [
    # a part of the right file, what stands there instead, the mistake's line, the message after file and line
    ("hierarchy: toys", "hierarchie: toys", "hierarchie:", "hierarchie: unknown field; did you mean 'hierarchy'?"),
    ("hierarchy: toys\n", "", "description", "hierarchy: missing; expected the hierarchy's name"),
    ("hierarchy: toys", "hierarchy: 12", "hierarchy", "hierarchy: expected text, got 12"),
    ("hierarchy: toys", "hierarchy: to ys", "hierarchy", "hierarchy: 'to ys' is no hierarchy's name: expected"),
    ("description: a counter and two that sum", "description: [a]", "descr", "description: expected text, got a list"),
    ("epochs: 3", "epochs: three", "epochs", "epochs: expected a whole number, got 'three'"),
    ("epochs: 3", "epochs: 3.5", "epochs", "epochs: expected a whole number, got 3.5"),
    ("epochs: 3", "epochs: true", "epochs", "epochs: expected a whole number, got true"),
    ("epochs: 3", "epochs: 0", "epochs", "epochs: expected at least 1, got 0"),
    ("epochs: 3", "staleness: 9", "staleness", "staleness: expected at most 8, got 9"),
    ("epochs: 3", "start_timeout_s: 0", "start", "start_timeout_s: expected more than 0, got 0"),
    ("epochs: 3", "start_timeout_s: .inf", "start", "start_timeout_s: expected a finite number, got inf"),
    ("epochs: 3", "start_timeout_s: soon", "start", "start_timeout_s: expected a number, got 'soon'"),
    ("epochs: 3", "certificates_s: 1e12", "certificates_s", "certificates_s: expected at most 3.1536e+08, got 1"),
    ("epochs: 3", "low_latency: 1", "low_latency", "low_latency: expected true or false, got 1"),
    ("epochs: 3", "low_latency: true\nstaleness: 1", "low_latency", "low_latency: goes with a staleness of 0 only"),
    ("epochs: 3", "zenoh: [a]", "zenoh", "zenoh: expected the path of a file, JSON5 text or a map, got ['a']"),
    ("epochs: 3", "zenoh: nowhere.json5", "zenoh", "zenoh: there is no file '"),
    ("epochs: 3", "restart_policy: always", "restart", "restart_policy: unknown field; "),
    ("epochs: 3", "restart: always", "restart", "restart: expected a map, got 'always'"),
    (
        "epochs: 3",
        "restart: {class: a:b}",
        "restart",
        "restart.class: unknown field; expected one of max_restart_delay",
    ),
    (
        "epochs: 3",
        "restart: {restart_policy: allways}",
        "restart",
        "restart.restart_policy: expected 'never', 'on-failure' or 'always', got 'allways'",
    ),
    ("epochs: 3", "restart: {max_restarts: -1}", "restart", "restart.max_restarts: expected at least 0, got -1"),
    ("epochs: 3", "restart: {restart_delay: -1}", "restart", "restart.restart_delay: expected at least 0, got -1"),
    ("epochs: 3", "restart: {restart_window: 0}", "restart", "restart.restart_window: expected more than 0, got 0"),
    (
        "epochs: 3",
        "restart: {restart_delay: 3, max_restart_delay: 2}",
        "restart",
        "restart.max_restart_delay: expected at least restart_delay, 3, got 2",
    ),
    (
        "{class: support.toy_nodes:Summer}",
        '{class: "support.toy_nodes:Summer", max_restart_delay: 0.01}',
        "  left:",
        "nodes.left.max_restart_delay: expected at least restart_delay, 0.1, got 0.01",
    ),
    (
        "{class: support.toy_nodes:Summer}",
        '{class: "support.toy_nodes:Summer", on_loss: ignore}',
        "  left:",
        "nodes.left.on_loss: expected 'restart', 'detach' or 'stop', got 'ignore'",
    ),
    ("epochs: 3", "modules: robots", "modules", "modules: expected a list, got 'robots'"),
    ("epochs: 3", "modules: [a, b c]", "modules", "modules[1]: expected 'package.module' or 'package.*', got 'b c'"),
    ("epochs: 3", "durability: disk", "durability", "durability: expected 'process' or 'host', got 'disk'"),
    ("epochs: 3", "epoch_deadline_s: 0", "epoch_deadline_s", "epoch_deadline_s: expected more than 0, got 0"),
    ("epochs: 3", "on_uncertain_act: ask", "on_unc", "on_uncertain_act: expected 'repeat' or 'skip', got 'ask'"),
    ("world: world\nparam", "param", "hierarchy", "world: missing; expected which node is the external world"),
    (
        "world: world\nparam",
        "world: wrld\nparam",
        "world: wrld",
        "world: there is no node 'wrld'; did you mean 'world'?",
    ),
    ("step: 2", "step: 2\n  step: 3", "step: 3", "parameters.step: given twice, in line 6 and in line 7"),
    (
        '"${step}"}',
        '"${stop}"}',
        "    parameters: {step",
        "nodes.world.parameters.step: unknown parameter ${stop}; did",
    ),
    (
        "  context: true",
        "  context: 1",
        "      enabled",
        "edges.left -> top.most.context.enabled: expected true or false, got 1 (from ${context}, FILE:8)",
    ),
    (
        "  world:\n    class",
        "  wor ld:\n    class",
        "  wor ld",
        "nodes.wor ld: 'wor ld' is no node's name: expected at most",
    ),
    (
        "    class: support.toy_nodes:Counter",
        "    scheduling: {polcy: fifo}\n    class: support.toy_nodes:Counter",
        "    scheduling:",
        "nodes.world.scheduling.polcy: unknown field; did you mean 'policy'?",
    ),
    (
        "    class: support.toy_nodes:Counter",
        "    clas: support.toy_nodes:Counter",
        "    clas:",
        "nodes.world.clas: unknown field; did you mean 'class'?",
    ),
    (
        "    class: support.toy_nodes:Counter\n",
        "",
        "  world:\n",
        "nodes.world.class: missing; expected module:name of a class",
    ),
    (
        "support.toy_nodes:Counter",
        "support.toy_nodes.Counter",
        "    class",
        "nodes.world.class: expected 'package.module:name', got 'support.toy_nodes.Counter'",
    ),
    (
        "{class: support.toy_nodes:Summer}",
        "support.toy_nodes:Summer",
        "  left:",
        "nodes.left: expected a map, got 'support.",
    ),
    ("{class: support.toy_nodes:Summer}", "", "  left:", "nodes.left: expected a map, got nothing"),
    (
        "{class: support.toy_nodes:Summer}",
        "{class: a:b, noise: 1}",
        "  left:",
        "nodes.left.noise: unknown field; expected one of budget_ms, class, every, max_restart_delay, ",
    ),
    (
        "{class: support.toy_nodes:Summer}",
        "{class: a:b, parameters: [1]}",
        "  left:",
        "nodes.left.parameters: expected a map, got a list",
    ),
    (
        "  world -> left:",
        "  world - left:",
        "  world - left:",
        "edges.world - left: 'world - left' is no edge: expected 'lower -> upper', two names of nodes",
    ),
    (
        "  world -> left:",
        "  world -> lift:",
        "  world -> lift:",
        "edges.world -> lift: there is no node 'lift'; did you mean 'left'?",
    ),
    (
        "  world -> left:",
        "  world -> left -> right:",
        "  world -> left ->",
        "edges.world -> left -> right: 'world -> left -> right' is no edge",
    ),
    ("  world -> left:", "  left->top.most:", "  left -> top.most", "edges.left -> top.most: given twice, in line"),
    ("  world -> left:", "  left -> left:", "edges:", "edges: edge left->left joins a node to itself"),
    ("  world -> left:", "  left -> world:", "edges:", "edges: nothing may be below the world 'world', but 'left' is"),
    ("  world -> left:", "  top.most -> left:", "edges:", "edges: the edges form a cycle: "),
    (
        "    task: null",
        "    tusk: null",
        "    tusk",
        "edges.left -> top.most.tusk: unknown field; did you mean 'task'?",
    ),
    (
        "    task: null",
        "    task: toy",
        "    task",
        "edges.left -> top.most.task: expected 'package.module:name', got 'toy'",
    ),
    ("    task: null", "    task: [a]", "    task", "edges.left -> top.most.task: expected a map, got a list"),
    (
        "      parameters: {factor: 2}",
        "      params: {factor: 2}",
        "      params",
        "edges.left -> top.most.context.params: unknown field; did you mean 'parameters'?",
    ),
    (
        "      function: support.toy_nodes:Scale\n",
        "",
        "    context:",
        "edges.left -> top.most.context.function: missing; expected module:name of a function",
    ),
    ("  - node: left", "  - node: lift", "  - node", "probes[0].node: there is no node 'lift'; did you mean 'left'?"),
    (
        "  - node: left\n    class",
        "  - class",
        "  - class",
        "probes[0].node: missing; expected the node that it watches",
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "part", "message"), MISTAKES, ids=[f"{new[:30]!r}" for _, new, _, _ in MISTAKES]
)
def test_a_mistake_is_told_in_one_line(tmp_path: Path, old: str, new: str, part: str, message: str) -> None:
    text = replaced(old, new)
    path = write(tmp_path, text)
    with pytest.raises(DeploymentError) as caught:
        read_deployment(path)
    assert str(caught.value).startswith(f"{path}:{line_of(part, text)}: {message.replace('FILE', str(path))}")
    assert "\n" not in str(caught.value)


def test_probes_that_are_no_list(tmp_path: Path) -> None:
    text = TOYS.replace("  - node: left", "    node: left")
    with pytest.raises(DeploymentError, match=r"\.yaml:31: probes: expected a list, got a map$"):
        read_deployment(write(tmp_path, text))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("epochs=0", "--set epochs=0: epochs: expected at least 1, got 0"),
        ("nodes.left.class=toys", "--set nodes.left.class=toys: nodes.left.class: expected 'package.module:name'"),
        (
            "context=2",
            "edges.left -> top.most.context.enabled: expected true or false, got 2 (from ${context}, --set context=2)",
        ),
        ("step=${stop}", "--set step=${stop}: parameters.step: unknown parameter ${stop}"),
        ("edges=null", "--set edges=null: edges: 'left', 'top.most' cannot be reached from the world 'world'"),
        ("nodes.left.parameters.x=${scale}${y}", "nodes.left.parameters.x: unknown parameter ${y}"),
        ("parameters=3", "--set parameters=3: parameters: expected a map from names to values, got 3"),
    ],
)
def test_a_mistake_in_an_override(tmp_path: Path, override: str, message: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        read_deployment(write(tmp_path), [override])
    assert message in str(caught.value)


def test_the_first_mistake_is_told(tmp_path: Path) -> None:
    text = (
        TOYS.replace("task: null", "tusk: null")
        .replace("epochs: 3", "epochs: 0")
        .replace("- node: left", "- nude: left")
    )
    with pytest.raises(DeploymentError, match=":3: epochs: expected at least 1"):
        read_deployment(write(tmp_path, text))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "toys.yaml: is empty; expected a map with hierarchy"),
        (b"# only a comment\n", "toys.yaml: is empty"),
        (b"- a\n- b\n", "toys.yaml:1: expected a map with hierarchy, world, nodes and edges, got a list"),
        (b"just text", "toys.yaml:1: expected a map with hierarchy, world, nodes and edges, got 'just text'"),
        (b"a: 1\nb: \xff\xfe\n", "toys.yaml:2: byte 0xff is not UTF-8; save the file as UTF-8"),
    ],
)
def test_what_is_no_deployment_at_all(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "toys.yaml"
    path.write_bytes(content)
    with pytest.raises(DeploymentError) as caught:
        read_deployment(path)
    assert message in str(caught.value)


def test_places_and_errors_of_later_stages(tmp_path: Path) -> None:
    class MisfitError(HieraxError):
        where = "nodes.top.most.parameters.scale"

    path = write(tmp_path)
    deployment = read_deployment(path, ["nodes.left.parameters.scale=3"])
    assert deployment.place("nodes.world.class") == f"{path}:{line_of('class: support.toy_nodes:Counter')}"
    assert deployment.place("nodes.left.parameters.scale") == "--set nodes.left.parameters.scale=3"
    line = line_of('scale: "${scale}"')
    assert str(deployment.explain(MisfitError(f"{MisfitError.where}: too much"))) == (
        f"{path}:{line}: nodes.top.most.parameters.scale: too much (from ${{scale}}, {path}:7)"
    )
    MisfitError.where = "nodes.extra.class"  # of a snippet: it is not in this file
    error = MisfitError("nodes.extra.class: there is none")
    assert deployment.explain(error) is error
    other = HieraxError("the link is down")
    assert deployment.explain(other) is other


LINES = TOYS.splitlines()
SCRAPS = [
    "",
    "[",
    "]",
    "{",
    "}",
    ":",
    "- ",
    "'",
    '"',
    "${",
    "${step}",
    "&a",
    "*a",
    "!!int ",
    "<<: ",
    "\t",
    "null",
    "1e3",
    "->",
]


def refusal(path: Path, overrides: list[str]) -> str | None:
    """The message of the error that reading raises; None where it raises none."""
    try:
        read_deployment(path, overrides)
    except DeploymentError as error:
        return str(error)
    return None


def mutated(seed: int) -> str:
    """The right file with some lines dropped, doubled, swapped, indented or filled with scraps."""
    draw = random.Random(seed)
    lines = list(LINES)
    for _ in range(draw.randint(1, 4)):
        at = draw.randrange(len(lines))
        other = draw.randrange(len(lines))
        match draw.randrange(6):
            case 0:
                del lines[at]
            case 1:
                lines.insert(other, lines[at])
            case 2:
                lines[at], lines[other] = lines[other], lines[at]
            case 3:
                lines[at] = " " * draw.randint(1, 4) + lines[at]
            case 4:
                lines[at] = lines[at].lstrip()
            case _:
                column = draw.randint(0, len(lines[at]))
                lines[at] = lines[at][:column] + draw.choice(SCRAPS) + lines[at][column + draw.randint(0, 3) :]
    return "\n".join(lines)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(100, 1000))
@given(
    seed=st.integers(0, 1 << 32), overrides=st.lists(st.sampled_from(["step=1", "epochs=2", "nodes.left.class=a:b"]))
)
def test_a_spoilt_file_gives_one_clear_error(tmp_path: Path, seed: int, overrides: list[str]) -> None:
    path = write(tmp_path, mutated(seed))
    message = refusal(path, overrides)
    assert message is None or (message.startswith((str(path), "--set")) and "\n" not in message)


PATHS = [
    "hierarchy",
    "description",
    "epochs",
    "world",
    "parameters",
    "nodes",
    "edges",
    "probes",
    "start_timeout_s",
    "low_latency",
    "zenoh",
    "step",
    "nodes.world",
    "nodes.left.class",
    "nodes.left.parameters",
    "edges.world -> left",
    "edges.world -> left.sense",
    "edges.left -> top.most.context.enabled",
    "edges.left -> top.most.context.parameters",
    "probes[0]",
    "probes[0].node",
]
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-3, 1 << 70)
    | st.floats()
    | st.sampled_from(["a", "a:b", "left", "${step}", "{"]),
    lambda inner: (
        st.lists(inner, max_size=2) | st.dictionaries(st.sampled_from(["class", "node", "x"]), inner, max_size=2)
    ),
    max_leaves=4,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(100, 1000))
@given(changes=st.lists(st.tuples(st.sampled_from(PATHS), VALUES), min_size=1, max_size=3))
def test_any_value_anywhere_is_taken_or_refused(tmp_path: Path, changes: list[tuple[str, object]]) -> None:
    overrides = [f"{path}={json.dumps(value)}" for path, value in changes]
    message = refusal(write(tmp_path), overrides)
    assert message is None or "\n" not in message
