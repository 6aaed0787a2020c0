"""The benchmark of towers: which scenes it runs with what, which rows it keeps, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tower
import tower_errors
import tower_kept
import tower_scenes

Ran = list[tuple[str, dict[str, str]]]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Ran:
    """What was run, by which command; scene 7 is not done, launched scene 8 has another digest, and in scene 3 nothing
    happens of what is asked of somebody."""
    calls: Ran = []

    def episode(command: str, set_to: dict[str, str]) -> dict[str, Any]:
        calls.append((command, dict(set_to)))
        acts = 0 if set_to["scene"] == "3" else tower_scenes.asked_of(set_to)
        done = float(set_to["scene"] != "7")
        world = {"towers_done": done, "placed_mm_max": 1.5, "interferences": float(acts), "actions": 8.0}
        digest = f"{command if set_to['scene'] == '8' else ''}{set_to['scene']:0>16}"
        nodes = {"world": {"metrics": world}, "skills": {"metrics": {"moves": 9.0}}}
        return {"nodes": nodes, "epochs": 600, "wall_s": 50.0, "digest": digest}

    monkeypatch.setattr(tower, "episode", episode)
    return calls


def test_each_cell_has_its_scenes_in_order(ran: Ran, capsys: pytest.CaptureFixture[str]) -> None:
    assert tower.main(["--scenes", "0:3", "--jobs", "2", "--person", "none,every,knock+take"]) == 0
    assert len(ran) == 3 * (1 + 8 + 1)
    assert json.loads(ran[-1][1]["person"]) == ["knock", "take"]
    assert {command for command, _ in ran} == {"run"}
    told = capsys.readouterr().out
    rows = [line.split()[:2] for line in told.splitlines() if "000000" in line]
    assert rows == 10 * [["0", "yes"], ["1", "yes"], ["2", "yes"]]
    assert told.count("3 of 3 done; at most 1.5 mm") == 10


def test_three_are_drawn_for_each_scene_and_a_context_is_left_out(ran: Ran) -> None:
    assert tower.main(["--scenes", "0:2", "--person", "random", "--without", "builder", "--set", "cubes=5"]) == 0
    acts = [json.loads(set_to["person"]) for _, set_to in ran]
    assert [len(set(each)) for each in acts] == [3, 3]
    assert acts == [tower_scenes.interferences("random", scene) for scene in (0, 1)]
    assert all(set_to["edges.skills -> builder.context"] == "null" for _, set_to in ran)
    assert all(set_to["cubes"] == "5" for _, set_to in ran)


@pytest.mark.slow
@pytest.mark.parametrize("without", tower_scenes.CONTEXTS)
def test_what_is_left_out_is_missed_by_the_nodes(without: str) -> None:
    """The deployment has an edge of that name, and without it, or with another function, nodes believe otherwise: what
    the builder knows comes down once it has known it for eight epochs; the second cube hides some of the first."""
    given = {"cubes": "2", "tower": "[1, 2]", "frames": "14"}
    whole, left = (
        tower_scenes.episode("run", tower_scenes.settings(given, 1, each))["digest"] for each in (None, without)
    )
    assert whole != left


def test_a_scene_that_is_not_done_and_a_launch_with_another_digest_are_told(
    ran: Ran, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tower.main(["--scenes", "7:8"]) == 1
    assert "0 of 1 done" in capsys.readouterr().out
    assert tower.main(["--scenes", "6:9", "--least", "2"]) == 0
    assert tower.main(["--scenes", "6:9", "--least", "3"]) == 1
    assert tower.main(["--scenes", "5:7", "--launched", "5:7"]) == 0
    assert tower.main(["--scenes", "8:10", "--launched", "8:10"]) == 1
    told = capsys.readouterr().out
    assert (told.count("launched, equal"), told.count("launched, OTHER DIGEST")) == (3, 1)


def test_where_nothing_happens_another_scene_is_run(ran: Ran, capsys: pytest.CaptureFixture[str]) -> None:
    assert tower.main(["--scenes", "2:4", "--person", "none"]) == 0
    assert "not counted" not in capsys.readouterr().out
    assert tower.main(["--scenes", "2:4", "--person", "knock"]) == 0
    assert "2 of 2 done; not counted: 3, where not all happened" in capsys.readouterr().out
    assert [set_to["scene"] for _, set_to in ran] == ["2", "3", "2", "3", "4"]
    assert tower.main(["--scenes", "2:4", "--person", "knock", "--launched", "3:5"]) == 0
    assert [set_to["scene"] for command, set_to in ran if command == "launch"] == ["4", "3"]
    assert tower.main(["--scenes", "3:7", "--person", "knock"]) == 1, "scene 7, in the place of 3, is not done"


def test_it_goes_on_where_it_was_ended(ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = tmp_path / "rows.jsonl"
    assert tower.main(["--scenes", "0:2", "--keep", str(keep)]) == 0
    assert tower.main(["--scenes", "0:4", "--launched", "0:1", "--keep", str(keep)]) == 0
    assert [(command, set_to["scene"]) for command, set_to in ran] == [
        *(("run", scene) for scene in "0123"),
        ("launch", "0"),
    ]
    assert len(keep.read_text().splitlines()) == 5
    monkeypatch.setattr(tower_kept, "sources", lambda: "others")
    assert tower.main(["--scenes", "0:1", "--keep", str(keep)]) == 0
    assert len(ran) == 6  # rows of other sources do not count


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda text: text[:-20], "line 2: expected a row that this program has written: it is cut off"),
        (lambda text: "[]\n" + text, "line 1: expected a row"),
        (lambda text: text.replace("frames", "fames"), "line 1: expected a row"),
        (lambda text: "\n" + text, "line 1: expected a row"),
    ],
)
def test_what_is_no_row_is_named(ran: Ran, tmp_path: Path, spoil: Callable[[str], str], said: str) -> None:
    keep = tmp_path / "rows.jsonl"
    tower.main(["--scenes", "0:2", "--keep", str(keep)])
    keep.write_text(spoil(keep.read_text()))
    before = keep.read_text()
    with pytest.raises(SystemExit, match=said):
        tower.main(["--scenes", "0:3", "--keep", str(keep)])
    assert keep.read_text() == before
    with pytest.raises(SystemExit, match="cannot be read and written"):
        tower.main(["--keep", str(tmp_path)])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenes", "3:3"], "expected the first scene and one above the last"),
        (["--scenes", "3"], "expected the first scene and one above the last"),
        (["--scenes", "a:b"], "expected the first scene and one above the last"),
        (["--set", "cubes"], "expected PATH=VALUE"),
        (["--set", "person=knock"], "the option of that name"),
        (["--jobs", "0"], "expected 1 or more"),
        (["--launch", "--launched", "0:2"], "makes no runs"),
        (["--launched", "2"], "--launched 2: expected the first scene"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        tower.main(words)
    assert said in capsys.readouterr().err


def test_errors_are_kept_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep = tmp_path / "errors.jsonl"
    few = ["--set", "cubes=2", "--set", "tower=[1, 2]", "--set", "frames=8", "--person", "none", "--least", "0"]
    assert tower_errors.main(["--scenes", "0:2", *few, "--keep", str(keep)]) == 0
    told = capsys.readouterr().out
    assert "of 2 scenes done" in told
    assert "of 32" in told.splitlines()[-1]  # both cubes, in all other epochs
    rows = keep.read_text()
    assert rows.count("\n") == 2
    assert tower_errors.main(["--scenes", "0:2", *few, "--keep", str(keep)]) == 0
    assert capsys.readouterr().out == told
    assert keep.read_text() == rows


def test_errors_need_somebody_who_works(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        tower_errors.main(["--jobs", "0"])
    assert "--jobs: expected 1 or more" in capsys.readouterr().err
