"""What each constant of the tracker does: the figures of tracking with half of it, and with twice of it.

    python benchmarks/sensitivities.py SCENES                   # draws scenes of generator A there, and tracks them
    python benchmarks/sensitivities.py SCENES --list            # the constants, without tracking
    python benchmarks/sensitivities.py SCENES --write docs/tracking-constants.md --log SCENES/found.jsonl

Constants are numbers, and tuples and arrays of numbers, that stand at the top of a module of the tracker under a name
in capitals: in ``constants.py`` but for what draws and simulates. Each is changed alone, in a process of its own, where
its module is loaded, so that whatever is made of it changes too. A share between 0.5 and 1 is changed in what it
leaves: half of 0.9 is 0.95, twice of it 0.8. Whole numbers stay whole, and at least 1.

Of each change the table has by how much the share of (object, frame) within 5 mm and 5° changes, and the one within
2 mm and 2°, in points over all scenes that are tracked with it; the mean distance from the truth, in micrometres; and
the objects lost. ``=``: all poses are the same to the last bit.
Constants of the search for objects of which no pose is told are changed on scenes that are tracked without; all others
on scenes with first poses. What changes nothing there is tried where things are knocked about, lost and found again,
and stands in parentheses. With ``--log`` what was found is kept, and not measured again.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import importlib.machinery
import json
import multiprocessing
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
TRACKING = ROOT / "nodes" / "tracking"
FOLDERS = ("estimation", "imagery", "search", "math")
FILES = ("arm.py", "spatial.py", "render.py", "constants.py")
FACTORS = (0.5, 2.0)
FAR_MM = 20.0

Scenes = tuple[tuple[str, int, int, int | None], ...]
"""Kinds, seeds, frames and numbers of objects; None: all."""

GROUPS: dict[str, Scenes] = {
    "given": (("hidden", 2, 12, None), ("alike", 91, 16, None)),
    "found": (("scattered", 0, 14, 2),),
    "again": (("knocked", 1, 40, None),),
}
"""Scenes with first poses, without, and those for what changes nothing in the first."""

MOST_S = 600
"""Some values, as of a number's base, end no more."""

POINTS, OFF_MM = 0.5, 0.05
"""What changes figures by no more than this hardly does."""

SEARCHING = ": without first poses"
"""How kinds end of what is only used without first poses."""

TECHNICAL = ("NO_", "_NO_", "NOTHING")
"""Names, or beginnings of them, of what is no constant to be chosen: empty values."""

CHANGE = "_changed_by_sensitivities"


class Constant(NamedTuple):
    """One constant: where it stands, and how."""

    file: str  # below `TRACKING`
    name: str  # ``NAME``, ``NAME.keyword``, ``Class.field`` or ``Class(argument)``
    line: int
    text: str  # as it is written
    about: str  # the comment beside it
    kind: str = ""  # the heading it stands under

    @property
    def key(self) -> str:
        """What tells it from the others."""
        return f"{self.file}:{self.name}"


class Task(NamedTuple):
    """One measurement."""

    constant: Constant | None  # what is changed; None: nothing
    factor: float
    scenes: Path  # their folder
    group: str

    @property
    def key(self) -> str:
        """What tells it from the others."""
        return _key(self.constant, self.factor, self.group)


class Figures(NamedTuple):
    """What tracking has come to."""

    near: float  # share within 5 mm and 5°
    exact: float  # share within 2 mm and 2°
    off_mm: float  # mean distance, what is farther away than `FAR_MM` or has no pose as that far
    lost: int  # objects
    poses: str  # digest of all of them


def constants() -> list[Constant]:
    """All constants, in the order in which they stand."""
    paths = [path for folder in FOLDERS for path in sorted((TRACKING / folder).glob("*.py"))]
    paths += [TRACKING / name for name in FILES if (TRACKING / name).is_file()]
    found = []
    for path in paths:
        text = path.read_text(encoding="utf-8")
        lines, file = text.splitlines(), path.relative_to(TRACKING).as_posix()
        for name, node in _numbers(ast.parse(text)):
            comment = lines[node.lineno - 1].partition("  # ")[2] or _above(lines, node.lineno - 2)
            found.append(Constant(file, name, node.lineno, ast.unparse(node), comment, _kind(lines[: node.lineno])))
    return found


def _kind(lines: Sequence[str]) -> str:
    """The heading that some lines end under."""
    return next((line.strip("# -") for line in reversed(lines) if line.startswith("# ----")), "")


def _above(lines: Sequence[str], at: int) -> str:
    """The comment above a line and those that stand just before it."""
    while at >= 0 and lines[at].strip() and not lines[at].startswith("#"):
        at -= 1
    first = at
    while first >= 0 and lines[first].lstrip().startswith("# ") and "----" not in lines[first]:
        first -= 1
    return " ".join(line.lstrip("# ") for line in lines[first + 1 : at + 1])


def _numbers(tree: ast.Module) -> Iterator[tuple[str, ast.expr]]:
    """Names and values of the constants of a module."""
    for statement in tree.body:
        if isinstance(statement, ast.Assign):
            yield from _assigned(statement.targets[0], statement.value)
        elif isinstance(statement, ast.ClassDef):
            for inner in statement.body:
                if isinstance(inner, ast.AnnAssign) and inner.value is not None and _is_number(inner.value):
                    yield f"{statement.name}.{ast.unparse(inner.target)}", inner.value
                if isinstance(inner, ast.FunctionDef) and inner.name == "__init__":
                    given = inner.args.args[len(inner.args.args) - len(inner.args.defaults) :]
                    for argument, value in zip(given, inner.args.defaults, strict=True):
                        if _is_number(value):
                            yield f"{statement.name}({argument.arg})", value


def _assigned(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for each, part in zip(target.elts, value.elts, strict=True):
            yield from _assigned(each, part)
        return
    name = ast.unparse(target)
    if not name.isupper() or name.startswith(TECHNICAL) or not _is_number(value):
        return
    if isinstance(value, ast.Call) and value.keywords and not isinstance(value.func, ast.Attribute):
        for keyword in value.keywords:
            if _is_number(keyword.value):
                yield f"{name}.{keyword.arg}", keyword.value
        return
    yield name, value


def _is_number(value: ast.expr) -> bool:
    """Whether it is made of numbers that are not zero."""
    literals = [each.value for each in ast.walk(value) if isinstance(each, ast.Constant)]
    return any(isinstance(each, (int, float)) and not isinstance(each, bool) and each for each in literals)


def changed(value: Any, factor: float) -> Any:
    """A constant's value, changed by a factor."""
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return max(1, round(value * factor)) if value > 0 else value
    if isinstance(value, float):
        return 1.0 - (1.0 - value) * factor if 0.5 < value < 1.0 else value * factor
    if isinstance(value, tuple):
        return tuple(changed(each, factor) for each in value)
    return (value * factor).astype(value.dtype) if hasattr(value, "dtype") else value


def figures(task: Task) -> Figures:
    """The figures with a constant changed; in a process that has loaded nothing of the tracker yet."""
    if task.constant is not None:
        _change(task.constant, task.factor)
    from hashlib import blake2b
    from tempfile import TemporaryDirectory

    import numpy as np

    from hierax.nodes.benchmarks.tracking import Scene, track
    from hierax.nodes.tracking.evaluation.scoring import score

    start = ["start=search"] if task.group == "found" else []
    errors: list[Any] = []
    digest = blake2b(digest_size=16)
    with TemporaryDirectory() as name:
        for kind, seed, frames, _ in GROUPS[task.group]:
            folder = _folder(task.scenes, kind, seed, frames) / "test" / "000001"
            scene = Scene(kind, seed, folder, folder.parents[1] / "truth" / folder.name, True)
            tracked = track(scene, "with all", start, Path(name))
            errors += tracked.errors
            for each in tracked.errors:
                digest.update(each.distance_mm.tobytes() + each.angle_deg.tobytes())
    total = score(errors)
    off = np.concatenate([np.where(np.isnan(each.distance_mm), FAR_MM, each.distance_mm) for each in errors])
    mean = float(np.minimum(off, FAR_MM).mean())
    return Figures(float(total.shares[1]), float(total.shares[0]), mean, total.lost, digest.hexdigest())


def _change(constant: Constant, factor: float) -> None:
    """From now on, have a module loaded with its constant changed."""
    path = str(TRACKING / constant.file)
    setattr(builtins, CHANGE, lambda value: changed(value, factor))
    before = importlib.machinery.SourceFileLoader.get_code

    def get_code(self: importlib.machinery.SourceFileLoader, fullname: str) -> Any:
        if Path(self.path).resolve() != Path(path).resolve():
            return before(self, fullname)
        tree = ast.parse(self.get_data(self.path))
        value = next(node for name, node in _numbers(tree) if name == constant.name)
        _Put(value).visit(tree)
        return compile(ast.fix_missing_locations(tree), self.path, "exec")

    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[method-assign]


class _Put(ast.NodeTransformer):
    """Puts a call around an expression."""

    def __init__(self, value: ast.expr) -> None:
        self._value = value

    def visit(self, node: ast.AST) -> Any:
        if node is self._value:
            return ast.copy_location(ast.Call(ast.Name(CHANGE, ast.Load()), [self._value], []), self._value)
        return self.generic_visit(node)


def _folder(scenes: Path, kind: str, seed: int, frames: int) -> Path:
    return scenes / f"{kind}-{seed}-{frames}"


def _draw(scenes: Path) -> None:
    from hierax.nodes.tracking.generator.scenes import write_scene

    for kind, seed, frames, objects in (each for group in GROUPS.values() for each in group):
        folder = _folder(scenes, kind, seed, frames)
        if not folder.is_dir():
            write_scene(folder, kind, seed, frames, False, objects)


def _one(task: Task) -> tuple[str, dict[str, Any]]:
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(MOST_S)
    try:
        return task.key, figures(task)._asdict()
    except Exception as error:  # what a constant's value breaks is told of it
        return task.key, {"failed": f"{type(error).__name__}: {error}"[:80]}


def _too_long(number: int, frame: object) -> None:
    raise TimeoutError(f"not done in {MOST_S} s")


def _key(constant: Constant | None, factor: float, group: str) -> str:
    return group if constant is None else f"{constant.key} {factor} {constant.text} {group}"


def _groups(constant: Constant) -> tuple[str, ...]:
    """The scenes that a constant is changed on, and those for one that changes nothing there."""
    return ("found",) if constant.kind.endswith(SEARCHING) else ("given", "again")


def _kept(log: Path | None) -> dict[str, Any]:
    if log is None or not log.is_file():
        return {}
    return dict(map(json.loads, log.read_text(encoding="utf-8").splitlines()))


def measure(tasks: Sequence[Task], found: dict[str, Any], log: Path | None, processes: int) -> None:
    """Add to what was found what each change comes to, by constant, factor, text and scenes."""
    left = [task for task in tasks if task.key not in found]
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["numpy", "cv2", "pybullet", "yaml", "hierax.runtime.deployment.read"])
    pool = ProcessPoolExecutor(processes, context, max_tasks_per_child=1)
    with pool:
        for number, (key, each) in enumerate(pool.map(_one, left), 1):
            found[key] = each
            print(f"{number}/{len(left)} {key} {each}", file=sys.stderr, flush=True)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([key, each]) + "\n")


def table(found: dict[str, Any], known: Sequence[Constant]) -> str:
    """The table as Markdown."""
    lines = []
    place = ""
    for each in known:
        if place != (place := each.kind or f"`{each.file}`"):
            lines += [
                "",
                f"## {place}",
                "",
                "| constant | is | of it a half | twice | for |",
                "| --- | --- | --- | --- | --- |",
            ]
        cells = [_cell(found, each, factor) for factor in FACTORS]
        text = each.text if len(each.text) <= 40 else each.text[:39] + "…"
        lines.append(f"| `{each.name}` | `{text}` | {cells[0]} | {cells[1]} | {each.about.replace('|', '/')} |")
    return "\n".join(lines) + "\n"


def _cell(found: dict[str, Any], constant: Constant, factor: float) -> str:
    first, *others = (_told(found, constant, factor, group) for group in _groups(constant))
    again = "".join(others)
    return f"({again})" if first == "=" and again not in ("", "=") else first


def _told(found: dict[str, Any], constant: Constant, factor: float, group: str) -> str:
    one, base = found.get(_key(constant, factor, group)), found.get(group, {})
    if one is None:
        return ""
    if "failed" in one:
        return "fails"
    if one["poses"] == base["poses"]:
        return "="
    near, exact = (100.0 * (one[name] - base[name]) for name in ("near", "exact"))
    lost = one["lost"] - base["lost"]
    off = 1000.0 * (one["off_mm"] - base["off_mm"])
    return f"{near:+.1f} / {exact:+.1f} / {off:+.0f}" + (f", {lost:+d} lost" if lost else "")


def summary(found: dict[str, Any], known: Sequence[Constant], left: int = 0) -> str:
    """What the table comes to, and how many constants are not measured yet."""
    most = [max(_noticed(one, base) for one, base in _measured(found, each)) for each in known]
    same, little, more = (most.count(degree) for degree in range(3))
    tuned, searching = (sum(each.kind.startswith(kind) for each in known) for kind in ("Tuned", "Tuned" + SEARCHING))
    told = "; ".join(
        f"{' and '.join(f'`{kind}`' for kind, *_ in scenes)} {100 * each['near']:.1f} / {100 * each['exact']:.1f} % "
        f"({each['off_mm']:.2f} mm, {each['lost']} lost)"
        for scenes, each in ((scenes, found[group]) for group, scenes in GROUPS.items() if group in found)
    )
    scenes = [_named(group) for group in GROUPS.values()]
    empty = f" Of {left} more constants cells are empty: they are not measured yet." if left else ""
    return f"""Of {len(known)} constants {tuned} are tuned, {searching} of them for what is looked for without first
poses; others are efforts, numerics, facts, and what draws and simulates needs. Changed to a half and to twice of what
they are, {same} leave all poses the same to the last bit, {little} change figures by at most
{POINTS} points and {OFF_MM * 1000:.0f} µm, and {more} by more
([what whole mechanisms do](decisions/0053-what-was-switched-off.md)).{empty}

Scenes are of generator A, which the constants are fitted on: {scenes[0]}
with first poses; {scenes[1]} without, for what only looks for objects; and {scenes[2]},
where objects are lost and found again, for what changes nothing in the first. With all as they are, right by 5 mm and
5° / 2 mm and 2° (off in the mean, objects lost) are: {told}.

Cells have the change of these shares in points and of the mean distance in micrometres, in parentheses in the last of
these scenes; `=`: all poses are the same. So few frames tell what a constant does, not how well it is chosen: one
object that is lost or not makes some five points. What the arm says of its certainty is not looked at: some of the
likelihood's constants change nothing else there. `make sensitivities` makes this page.
"""


def _measured(found: dict[str, Any], constant: Constant) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """What each change of a constant has come to, and what there is without it."""
    keys = [(_key(constant, factor, group), group) for factor in FACTORS for group in _groups(constant)]
    return [(found[key], found[group]) for key, group in keys if key in found]


def _noticed(one: dict[str, Any], base: dict[str, Any]) -> int:
    """0: all poses are the same; 1: figures hardly change; 2: they do."""
    if one.get("poses") == base["poses"]:
        return 0
    if "failed" in one or one["lost"] != base["lost"]:
        return 2
    points = max(100.0 * abs(one[name] - base[name]) for name in ("near", "exact"))
    return 1 if points <= POINTS and abs(one["off_mm"] - base["off_mm"]) <= OFF_MM else 2


def _named(scenes: Scenes) -> str:
    return " and ".join(
        f"`{kind}` (seed {seed}, {frames} frames{'' if objects is None else f', {objects} objects'})"
        for kind, seed, frames, objects in scenes
    )


def _measure_all(known: Sequence[Constant], found: dict[str, Any], options: argparse.Namespace) -> None:
    """All changes; those that change nothing where things are lost, too."""
    bases = [Task(None, 1.0, options.scenes, group) for group in GROUPS]
    changes = [Task(each, factor, options.scenes, _groups(each)[0]) for each in known for factor in FACTORS]
    measure([*bases, *changes], found, options.log, options.processes)
    same = [task for task in changes if found[task.key].get("poses") == found[task.group]["poses"]]
    again = [task._replace(group="again") for task in same if task.group == "given"]
    measure(again, found, options.log, options.processes)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "scenes", type=Path, metavar="SCENES", help="Folder for scenes; those that are there are taken."
    )
    parser.add_argument("--list", action="store_true", help="Print the constants alone.")
    parser.add_argument("--only", default="", help="Only constants whose file and name contain one of these.")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--log", type=Path, help="File of what was found; what stands there is not measured again.")
    parser.add_argument("--told", action="store_true", help="Measure nothing: tell what the log has.")
    parser.add_argument("--write", type=Path, help="File for the table; by default it is printed.")
    options = parser.parse_args()
    known = [each for each in constants() if any(part in each.key for part in options.only.split(","))]
    if options.list:
        for each in known:
            print(f"{each.key}  {each.text}  {each.about}")
        print(f"{len(known)} constants")
        return 0
    found = _kept(options.log)
    if not options.told:
        _draw(options.scenes)
        _measure_all(known, found, options)
    measured = [each for each in known if all(_key(each, factor, _groups(each)[0]) in found for factor in FACTORS)]
    text = summary(found, measured, len(known) - len(measured)) + table(found, known)
    if options.write is None:
        print(text)
    else:
        options.write.write_text("# The tracker's constants\n\n" + text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
