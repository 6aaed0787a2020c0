"""Whether what hierax needs is installed."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from operator import eq, ge, gt, le, lt, ne
from typing import NamedTuple

from hierax.runtime.host.interpreter import python_code

FINE, NOTE, WRONG = "fine", "note", "wrong"
IMPORT_TIMEOUT_S = 60.0
_IMPORTED_AS = {"eclipse-zenoh": "zenoh", "opencv-python-headless": "cv2", "pyyaml": "yaml"}
_MARK = "hierax-doctor:"
_IMPORTER = f"""
import importlib
for name in sys.argv:
    try:
        importlib.import_module(name)
    except BaseException as error:
        print({_MARK!r} + name + ":" + type(error).__name__ + ": " + " ".join(str(error).split()), flush=True)
"""
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*([^;]*)(?:;(.*))?")
_BOUND = re.compile(r"(>=|<|==|>|<=|!=)\s*([0-9.]+)")
_COMPARISONS = {">=": ge, "<=": le, ">": gt, "<": lt, "==": eq, "!=": ne}
_EXTRA = re.compile(r"""extra\s*==\s*["']([^"']+)["']""")


class Finding(NamedTuple):
    """What was found in one place."""

    check: str  # what was looked at
    state: str  # `FINE`, `NOTE` (worth knowing) or `WRONG`
    what: str  # what is there
    mend: str = ""  # what to do about it; empty where nothing is to be done


def check_packages(wanted: Iterable[str] | None = None) -> Iterator[Finding]:
    """What hierax needs is installed, in versions that do, and can be imported."""
    lacking: dict[str, list[str]] = {}
    sound: dict[str, str] = {}
    for requirement in (requires("hierax") or ()) if wanted is None else wanted:
        match = _REQUIREMENT.fullmatch(requirement.strip())
        if match is None:
            continue
        extra = _EXTRA.search(match[3] or "")
        fault = _fault(match[1], match[2])
        if fault and extra is None:
            yield Finding("package", WRONG, *fault)
        elif fault and extra is not None and extra[1] != "dev":
            lacking.setdefault(extra[1], []).append(match[1])
        elif extra is None:
            sound[_IMPORTED_AS.get(match[1].lower(), match[1].replace("-", "_").lower())] = match[1]
    faults = _import_faults(list(sound)) if sound else {}
    for module, name in sound.items():
        if module in faults:
            mend = f"pip install --force-reinstall {name}; or install the library of the system that it misses"
            yield Finding("package", WRONG, f"{name} cannot be imported: {faults[module]}", mend)
        else:
            yield Finding("package", FINE, f"{name} {version(name)}")
    for extra_name, names in sorted(lacking.items()):
        mend = f"where it is wanted: pip install 'hierax[{extra_name}]'"
        yield Finding("package", NOTE, f"extra {extra_name!r}: {', '.join(names)} not installed", mend)


def _fault(name: str, bounds: str) -> tuple[str, str] | None:
    """What is wrong with a package, and how it is mended."""
    mend = f"pip install '{name}{bounds.strip()}'"
    try:
        found = version(name)
    except PackageNotFoundError:
        return f"{name} is not installed", mend
    for comparison, bound in _BOUND.findall(bounds):
        if not _COMPARISONS[comparison](_numbers(found), _numbers(bound)):
            return f"{name} {found}: expected {bounds.strip()}", mend
    return None


def _import_faults(modules: Sequence[str]) -> dict[str, str]:
    """Why modules cannot be imported, of those that cannot; tried in another process, as some of them print."""
    command = python_code(_IMPORTER, *modules)
    done = subprocess.run(command, capture_output=True, text=True, timeout=IMPORT_TIMEOUT_S, check=False)
    faults = dict(line[len(_MARK) :].split(":", 1) for line in done.stdout.splitlines() if line.startswith(_MARK))
    if done.returncode:  # one has ended the process
        faults.setdefault(modules[0], f"the process that imported it ended with code {done.returncode}")
    return faults


def _numbers(text: str) -> list[int]:
    """The first three numbers of a version."""
    return [int(part) for part in [*re.findall(r"\d+", text), 0, 0, 0][:3]]
