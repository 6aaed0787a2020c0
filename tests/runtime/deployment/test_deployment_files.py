from __future__ import annotations

from pathlib import Path

import pytest

from hierax.runtime.deployment import DeploymentError
from hierax.runtime.deployment.deployment import MAX_FILE_BYTES, find_file, import_paths, read_text, shipped


def test_a_file_is_found_before_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = next(iter(shipped()))
    monkeypatch.chdir(tmp_path)
    assert find_file(name) == shipped()[name]
    Path(name).write_text("a: 1")
    assert find_file(name) == Path(name)


def test_a_folder_of_that_name_does_not_hide_a_shipped_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = next(iter(shipped()))
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()
    assert find_file(name) == shipped()[name]


@pytest.mark.parametrize("wrong", ["lettres", "lettres.yaml", "somewhere/lettres.yaml"])
def test_the_nearest_shipped_name(wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DeploymentError) as caught:
        find_file(wrong)
    assert str(caught.value) == (
        f"{wrong}: there is no such file, and no shipped deployment of that name; did you mean 'letters'?"
    )


@pytest.mark.parametrize("wrong", ["folower.yaml", "follower", "follower.yml", "Follower.yaml"])
@pytest.mark.parametrize("folder", ["", "sub/"])
def test_the_nearest_file_beside(wrong: str, folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sub").mkdir()
    Path(folder, "follower.yaml").touch()
    Path(folder, "follower.py").touch()
    with pytest.raises(DeploymentError, match=rf"^{folder}{wrong}: .*; did you mean '{folder}follower\.yaml'\?$"):
        find_file(f"{folder}{wrong}")


def test_the_shipped_names_where_none_is_near() -> None:
    with pytest.raises(DeploymentError, match=r"; the shipped ones are .*letters, "):
        find_file("zzz")


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000])
def test_a_name_that_no_file_can_have(name: str) -> None:
    with pytest.raises(DeploymentError):
        find_file(name)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(DeploymentError, match="is no file; expected a deployment file"):
        find_file(tmp_path)


def test_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DeploymentError, match=r"gone\.yaml: cannot be read: No such file"):
        read_text(tmp_path / "gone.yaml")


def test_a_file_of_another_kind(tmp_path: Path) -> None:
    path = tmp_path / "film.yaml"
    path.write_bytes(bytes(MAX_FILE_BYTES + 1))
    with pytest.raises(DeploymentError, match="has more than 4194304 bytes; is it a deployment file"):
        read_text(path)


def test_a_byte_order_mark_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1")
    assert read_text(path) == "a: 1"


def test_the_files_folder_comes_before_the_current_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path)
    assert import_paths(Path("sub/a.yaml")) == (str(tmp_path / "sub"), str(tmp_path))
    assert import_paths(Path("a.yaml")) == (str(tmp_path),)


def test_a_recording_is_known_as_one(tmp_path: Path) -> None:
    path = tmp_path / "toys.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(9))
    with pytest.raises(DeploymentError, match=f"is a recording; expected a deployment file. `hierax replay {path}`"):
        read_text(path)


def test_an_empty_name_is_shown() -> None:
    with pytest.raises(DeploymentError, match=r"^'': is no file; expected a deployment file"):
        find_file("")
