"""``hierax export``: what units start is the run, and goes on with it, with the digests of ``hierax run``."""

from __future__ import annotations

import json
import os
import shlex
import signal
import stat
import subprocess
from pathlib import Path

import pytest
import yaml
from support.launched import run_here, said_here
from support.live import until

EPOCHS = 4000
SETTINGS = ("--set", "noise=0.2")


def exported(kind: str, file: str, folder: Path, *arguments: str) -> Path:
    done = said_here("export", kind, file, "-o", str(folder), *arguments)
    assert done.returncode == 0, done.stderr
    return folder


def command_of(unit: Path, state: Path) -> list[str]:
    """What a unit starts, as systemd reads it."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    (found,) = (line.partition("=")[2] for line in lines if line.startswith("ExecStart="))
    return shlex.split(found.replace("%S", str(state)).replace("%%", "%").replace("$$", "$"))


def environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder)}


def test_a_units_command_begins_goes_on_and_ends(tmp_path: Path) -> None:
    folder = exported("systemd", "servo", tmp_path / "units", "--epochs", str(EPOCHS), "--seed", "3", *SETTINGS)
    start = command_of(folder / "hierax-servo.service", tmp_path)
    health = command_of(folder / "hierax-servo-health.service", tmp_path)
    own = environment(tmp_path)
    killed = subprocess.Popen(start, env=own, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    digests = tmp_path / "hierax-servo" / "output" / "digests.msgpack"
    until(lambda: digests.exists() and digests.stat().st_size, "the first epochs")
    until(lambda: subprocess.run(health, env=own, capture_output=True, check=False).returncode == 0, "its health")
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    again = subprocess.run(start, env=own, capture_output=True, text=True, timeout=120, check=False)
    assert again.returncode == 0, again.stderr
    summary = json.loads((tmp_path / "hierax-servo" / "output" / "summary.json").read_text(encoding="utf-8"))
    wanted = run_here("servo", "--epochs", str(EPOCHS), "--seed", "3", *SETTINGS)
    assert (summary["epochs"], summary["digest"]) == (EPOCHS, wanted["digest"])
    over = subprocess.run(start, env=own, capture_output=True, text=True, timeout=120, check=False)
    assert over.returncode == 0, over.stderr
    assert f"the run is over, it has done {EPOCHS} epochs" in over.stderr
    assert subprocess.run(health, env=own, capture_output=True, check=False).returncode == 1


def test_a_run_goes_on_in_the_folder_of_another_file_under_no_circumstances(tmp_path: Path) -> None:
    done = said_here("launch", "servo", "--epochs", "5", "--resume", str(tmp_path / "run"), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    done = said_here("launch", "letters", "--resume", str(tmp_path / "run"), folder=tmp_path)
    assert done.returncode == 1
    assert "not of letters" in done.stderr
    done = said_here("launch", "servo", "--resume", str(tmp_path / "run"), "--set", "noise=0.5", folder=tmp_path)
    assert (done.returncode, "the run knows its settings" in done.stderr) == (1, True)


@pytest.mark.parametrize("kind", ["compose", "kubernetes"])
def test_a_file_of_ones_own_comes_along(kind: str, tmp_path: Path) -> None:
    shipped = Path(__file__).parents[3] / "deploy" / "servo.yaml"
    own = tmp_path / "mine.yaml"
    own.write_text(shipped.read_text(encoding="utf-8"), encoding="utf-8")
    folder = exported(kind, str(own), tmp_path / "out")
    told = (folder / "hierax-servo.yaml").read_text(encoding="utf-8")
    if kind == "kubernetes":
        (told,) = (
            each["data"]["hierax-servo.yaml"] for each in yaml.safe_load_all(told) if each["kind"] == "ConfigMap"
        )
    assert told == own.read_text(encoding="utf-8")
    refused = said_here("export", kind, str(own), "-o", str(folder))
    assert (refused.returncode, "--overwrite replaces it" in refused.stderr) == (1, True)
    exported(kind, str(own), folder, "--overwrite")


def test_a_secret_file_is_for_its_user_alone(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    text = (Path(__file__).parents[3] / "deploy" / "servo.yaml").read_text(encoding="utf-8")
    own.write_text(f"{text}\nzenoh: {{transport: {{auth: {{usrpwd: {{user: me, password: hidden}}}}}}}}\n")
    path = exported("kubernetes", str(own), tmp_path / "out") / "hierax-servo.yaml"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o644)  # as one is in which there was no secret yet
    exported("kubernetes", str(own), tmp_path / "out", "--overwrite")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    "arguments", [("systemd", "servo"), ("compose",), ("letters.mcap",), ("nomad", "servo", "-o", "x"), ("a.mcap", "b")]
)
def test_what_it_takes_is_told(arguments: tuple[str, ...]) -> None:
    done = said_here("export", *arguments)
    assert done.returncode == 2
    assert "expected RECORDING --rosbag DIR, or one of systemd, compose, kubernetes with FILE -o DIR" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("--epochs", "99999999999999999999999"), 2, "--epochs"),
        (("--seed", "99999999999999999999999"), 2, "--seed"),
        (("--image", ""), 2, "--image '': expected the name of an image"),
        (("--image", "a b; rm"), 2, "--image 'a b; rm': expected the name of an image"),
        (("--set", "noise=abc"), 1, "noise"),
        (("--set", "zenoh={foo: 1}"), 1, "zenoh: Zenoh: "),
    ],
)
def test_what_a_launch_would_refuse_is_not_written(
    arguments: tuple[str, ...], code: int, told: str, tmp_path: Path
) -> None:
    done = said_here("export", "kubernetes", "servo", "-o", str(tmp_path / "out"), *arguments)
    assert (done.returncode, told in done.stderr) == (code, True), done.stderr
    assert not (tmp_path / "out").exists()


def test_an_image_may_have_a_registry_a_tag_and_a_digest(tmp_path: Path) -> None:
    exported("compose", "servo", tmp_path / "out", "--image", f"[::1]:5000/lab/hierax:1.2_a@sha256:{'0' * 64}")
