"""What the README shows works as shown."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"

REST_OF_THE_HOUSE = """
from hierax.runtime import NO_TICK, Tick, World


class Weather(World):
    def __init__(self, noise: float) -> None:
        self.noise = noise

    def initial_belief(self) -> Value:
        return {"celsius": 10.0}


class Season(Node):
    def initial_belief(self) -> Value:
        return {"expected": 12.0}


def reading(belief: Value, tick: Tick = NO_TICK) -> Elements:
    return ({"celsius": belief["celsius"] + float(tick.rng.normal())},)


def temperature(belief: Value) -> Elements:
    return (belief,)


def expected(belief: Value) -> Elements:
    return (belief,)
"""


def block(language: str, number: int = 0) -> str:
    return str(re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[number])


def hierax(folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "hierax.runtime.commands.entry", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False, env=os.environ)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_node_and_the_deployment_file_run(tmp_path: Path) -> None:
    (tmp_path / "house.py").write_text(block("python") + REST_OF_THE_HOUSE, encoding="utf-8")
    (tmp_path / "house.yaml").write_text(block("yaml"), encoding="utf-8")
    hierax(tmp_path, "validate", "house.yaml", "--set", "noise=0.2")
    reports = [json.loads(hierax(tmp_path, mode, "house.yaml", "--format", "json")) for mode in ("run", "launch")]
    assert reports[0]["digest"] == reports[1]["digest"]
    assert reports[0]["epochs"] == 100
    assert reports[0]["nodes"]["room"]["belief"] == {"celsius": 12.0}


def test_the_script_runs_as_the_file_does(tmp_path: Path) -> None:
    (tmp_path / "house.py").write_text(block("python") + REST_OF_THE_HOUSE, encoding="utf-8")
    (tmp_path / "house.yaml").write_text(block("yaml"), encoding="utf-8")
    ends = "    print(run.report().digest)\n    assert house.to_yaml('written.yaml')\n"
    (tmp_path / "script.py").write_text(block("python", 1) + ends, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    digests = [
        json.loads(hierax(tmp_path, "run", each, "--format", "json"))["digest"]
        for each in ("house.yaml", "written.yaml")
    ]
    assert [done.stdout.splitlines()[-1]] * 2 == digests


def test_every_shipped_deployment_is_named() -> None:
    names = {path.stem for path in (README.parent / "deploy").glob("*.yaml")}
    assert names == set(re.findall(r"^\| `([a-z-]+)` \| ", README.read_text(encoding="utf-8"), re.MULTILINE))
