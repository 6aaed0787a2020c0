"""The tracking benchmark on scenes of few frames: its rows, its differences, and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hierax.nodes.benchmarks.tracking import CONTEXT, OWN, WAYS, Gain, Row, gains, generator
from hierax.nodes.tracking.datasets.truth import read_truth
from hierax.nodes.tracking.generator.kinds import KINDS
from hierax.nodes.tracking.math.geometry import exp_se3
from hierax.runtime.commands.main import main


def test_all_ways_give_rows_with_shares_and_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["bench", "tracking", "--kinds", "hidden", "--frames", "4", "--keep", str(tmp_path)]
    assert main([*arguments, "--format", "json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [row["way"] for row in report["rows"]] == list(WAYS)
    for row in report["rows"]:
        assert row["scene"] == "hidden"
        assert 0.0 <= row["shares"]["within_10mm_5deg"] <= 1.0
        assert set(row["stage_ms"]) == {"world", "arm", "spatial"}
        assert all(ms > 0.0 for ms in row["stage_ms"].values())
    (gain,) = report["gains"]
    shares = {row["way"]: row["hidden_shares"][0] for row in report["rows"]}
    assert gain["mean"] == pytest.approx(shares[CONTEXT] - shares[OWN])
    scene = tmp_path / "hidden-0-4" / "test" / "000001"
    assert main(["bench", "tracking", "--scene", str(scene), "--table", "--ways", CONTEXT]) == 0
    out = capsys.readouterr().out
    assert CONTEXT in out
    assert OWN not in out


def test_the_gain_is_of_scenes_with_hidden_frames_alone() -> None:
    def row(way: str, shares: list[float]) -> Row:
        return Row("hidden", way, None, {}, shares)

    nan = float("nan")
    (gain,) = gains([row(OWN, [0.2, nan, 0.5]), row(CONTEXT, [0.6, nan, 0.5])])
    assert gain.differences == pytest.approx([0.4, 0.0])
    plain = gain.plain()
    assert (plain["seeds"], plain["mean"]) == (2, pytest.approx(0.2))
    assert plain["spread"] == pytest.approx(np.std([0.4, 0.0], ddof=1))
    assert Gain("one", [0.1]).plain()["spread"] is None
    assert gains([row(CONTEXT, [0.6])]) == []
    assert gains([row(OWN, [nan]), row(CONTEXT, [nan])]) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--kinds", "heap"], f"there is no kind 'heap'; expected some of {', '.join(KINDS)}"),
        (["--generator", "C"], "C: no such program; expected A, B or the path of a generator"),
        (["--ways", "best"], "there is no way 'best'; expected some of own model"),
        (["--scene", "nowhere/test/000001"], "nowhere/test/000001: no such folder; expected a BOP scene"),
        (["--kinds", "tower", "--frames", "2", "--set", "nodes.arm.parameters.speed=1"], "speed"),
    ],
)
def test_what_is_wrong_is_one_line(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "tracking", *arguments]) == 1
    out, err = capsys.readouterr()
    assert said in err
    assert err.count("\n") == 1
    assert "Traceback" not in out + err


PROGRAM = """
import sys
from pathlib import Path
from hierax.nodes.tracking.generator.scenes import write_scene
if "--kinds" in sys.argv:
    print("lone")
else:
    assert sys.argv[2:] == ["--kind=lone", "--seed=0", "--frames=3", "--exact"], sys.argv
    print(write_scene(Path(sys.argv[1]), "scattered", 0, 3, True, 1))
"""


def test_scenes_of_another_generator_are_tracked_and_beliefs_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "mine.py"
    program.write_text(PROGRAM)
    arguments = ["bench", "tracking", "--generator", str(program), "--frames", "3", "--exact", "--ways", CONTEXT]
    assert main([*arguments, "--keep", str(tmp_path), "--format", "json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["scene"], row["objects"], row["frames"]) == ("lone", 1, 3)
    with np.load(tmp_path / "lone-0-with-all.beliefs.npz") as archive:
        beliefs = dict(archive)
    truth = read_truth(tmp_path / "lone-0-exact-3" / "truth" / "000001")
    assert beliefs["frame"].tolist() == [0, 1, 2]
    assert set(beliefs["status"].tolist()) <= {"tracked", "expected"}
    assert beliefs["covariance"].shape == (3, 6, 6)
    for at in range(3):
        np.testing.assert_allclose(beliefs["pose"][at] @ exp_se3(beliefs["twist"][at]), truth[at][0].pose, atol=1e-9)
        assert beliefs["distance_mm"][at] == pytest.approx(1000.0 * np.linalg.norm(beliefs["twist"][at][:3]), rel=0.01)
    np.testing.assert_allclose(beliefs["visible"], [truth[at][0].visible for at in range(3)])
    program.write_text("import sys\nsys.exit('error: out of paint')")
    assert main([*arguments, "--keep", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"error: {program}: out of paint\n"


def test_a_scene_without_truth_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hierax.runtime.loading.allowance import Allowance
    from hierax.runtime.loading.loader import load

    ours = Allowance(("hierax.nodes.tracking.generator.scenes",))
    scene = load("hierax.nodes.tracking.generator.scenes:write_scene", "test", ours)(tmp_path, "tower", 0, 2)
    assert main(["bench", "tracking", "--scene", str(scene), "--truth", str(tmp_path), "--ways", CONTEXT]) == 1
    assert "scene_gt.json: no such file" in capsys.readouterr().err


def test_the_speed_is_that_of_launches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    arguments = ["bench", "tracking", "--speed", "--frames", "3", "--rounds", "1", "--keep", str(tmp_path)]
    assert main([*arguments, "--format", "json"]) == 0
    speeds = json.loads(capsys.readouterr().out)["speeds"]
    assert [speed["objects"] for speed in speeds] == [1, 5, 20]
    for speed in speeds:
        assert speed["rounds"] == [speed["epochs_hz"]]
        assert speed["epochs_hz"] > 0.0
        assert speed["stage_ms"]["arm"] > 0.0
    assert len(list((tmp_path / "speed-1" / "models").glob("*.ply"))) == 1


def test_a_generator_that_is_executable_is_run_as_itself_and_a_python_file_by_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shell, python = Path("gen.sh"), Path("gen.py")
    shell.write_text("#!/bin/sh\necho heap tower\n")
    python.write_text("#!/bin/false\nprint('lone')\n")
    for program in (shell, python):
        program.chmod(0o755)
    assert generator("gen.sh").kinds() == ["heap", "tower"]
    assert generator("gen.py").kinds() == ["lone"]
    python.chmod(0o644)
    assert generator("gen.py").kinds() == ["lone"]
