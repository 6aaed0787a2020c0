"""The script that changes each constant of the tracker: which it finds; a change reaches what is made of a constant."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "benchmarks" / "sensitivities.py"


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sensitivities", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["sensitivities"] = module
    spec.loader.exec_module(module)
    return module


SENSITIVITIES = script()
MOST_TUNED = 162


def test_constants_are_found_wherever_they_stand() -> None:
    found = {each.name: each for each in SENSITIVITIES.constants()}
    assert found["GAMMA"].text == "2.2"
    assert found["GAMMA"].about.startswith("A lens adds up light")
    assert (found["NOISE_PX"].text, found["NOISE_PX"].kind) == ("0.7", "Tuned")
    assert (found["SURE_NATS"].text, found["SURE_NATS"].kind) == ("19.0", "Tuned: without first poses")
    assert found["MOTION_RAD"].about.startswith("Nodes' parameters: standard deviations")
    assert found["STEP_S"].file == "imagery/physics.py"


DRAWN_AND_SIMULATED = {"imagery/layers.py", "imagery/physics.py", "math/batched.py", "math/geometry.py"}


def test_the_trackers_constants_stand_in_one_file_each_with_its_reason() -> None:
    found = SENSITIVITIES.constants()
    assert {each.file for each in found} == {"constants.py"} | DRAWN_AND_SIMULATED
    chosen = [each for each in found if each.file == "constants.py"]
    assert not [each.name for each in chosen if not each.about]
    assert {each.kind for each in chosen} == {"Tuned", "Effort", "Numerics", "Facts"} | {
        f"{kind}{SENSITIVITIES.SEARCHING}" for kind in ("Tuned", "Effort")
    }


def test_no_more_constants_are_tuned_than_were() -> None:
    """What comes in has to have something go out."""
    tuned = [each for each in SENSITIVITIES.constants() if each.kind.startswith("Tuned")]
    assert len(tuned) <= MOST_TUNED


@pytest.mark.parametrize(
    ("value", "half", "twice"),
    [
        (3.0, 1.5, 6.0),
        (0.9, 0.95, 0.8),
        (1, 1, 2),
        (10, 5, 20),
        (0, 0, 0),
        ((0.0, 2.0, 4), (0.0, 1.0, 2), (0.0, 4.0, 8)),
        (True, True, True),
    ],
)
def test_what_half_of_a_constant_is_and_twice(value: object, half: object, twice: object) -> None:
    assert SENSITIVITIES.changed(value, 0.5) == pytest.approx(half)
    assert SENSITIVITIES.changed(value, 2.0) == pytest.approx(twice)


def test_arrays_keep_their_type() -> None:
    doubled = SENSITIVITIES.changed(np.array([1.0, 2.0], dtype=np.float32), 2.0)
    assert (doubled.dtype, doubled.tolist()) == (np.dtype("float32"), [2.0, 4.0])


def test_a_change_reaches_what_is_made_of_the_constant() -> None:
    code = """
import sensitivities as s
known = {each.key: each for each in s.constants()}
s._change(known["constants.py:GAMMA"], 2.0)
from hierax.nodes.tracking.estimation.profiles import const
print(const.GAMMA, round(float(const.LIGHT[128]), 3), const.BESIDE_PX[-1])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=SCRIPT.parent, capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.split() == ["4.4", f"{255.0 * (128 / 255.0) ** 4.4:.3f}", "4"]


def test_the_table_says_what_changed_and_what_did_not() -> None:
    known = [SENSITIVITIES.Constant("arm.py", "_A", 1, "2.0", "px"), SENSITIVITIES.Constant("arm.py", "_B", 2, "3", "")]
    base = {"near": 0.9, "exact": 0.8, "off_mm": 0.5, "lost": 0, "poses": "a"}
    other = {"near": 0.88, "exact": 0.8, "off_mm": 0.7, "lost": 1, "poses": "b"}
    found = {"given": base, "found": base, "again": base, "arm.py:_A 0.5 2.0 given": base}
    found |= {"arm.py:_A 2.0 2.0 given": base, "arm.py:_A 0.5 2.0 again": base, "arm.py:_A 2.0 2.0 again": base}
    found |= {"arm.py:_B 0.5 3 given": other, "arm.py:_B 2.0 3 given": {"failed": "ValueError: no"}}
    text = SENSITIVITIES.table(found, known)
    assert "| `_A` | `2.0` | = | = | px |" in text
    assert "| `_B` | `3` | -2.0 / +0.0 / +200, +1 lost | fails |  |" in text
    told = SENSITIVITIES.summary(found, known)
    assert "Of 2 constants 0 are tuned" in told
    assert "1 leave all poses the same to the last bit, 0 change figures by at most\n0.5 points" in told
    assert "and 1 by more\n" in told
    assert "`hidden` and `alike` 90.0 / 80.0 % (0.50 mm, 0 lost); `scattered` 90.0 / 80.0" in told
    found["arm.py:_A 2.0 2.0 again"] = other
    assert "| `_A` | `2.0` | = | (-2.0 / +0.0 / +200, +1 lost) | px |" in SENSITIVITIES.table(found, known)
