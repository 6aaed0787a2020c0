from __future__ import annotations

from pathlib import Path

import pytest

from hierax.runtime.tools.doctor import FINE, NOTE, WRONG, check_packages


def test_what_hierax_needs_is_here() -> None:
    found = list(check_packages())
    assert {finding.state for finding in found} <= {FINE, NOTE}
    assert any(finding.what.startswith("numpy ") for finding in found)


@pytest.mark.parametrize(
    ("requirement", "state", "what", "mend"),
    [
        ("numpy>=1.0", FINE, "numpy ", ""),
        ("numpy<99,>=2.0.0", FINE, "numpy ", ""),
        ("numpy>=99", WRONG, "expected >=99", "pip install 'numpy>=99'"),
        ("numpy<2", WRONG, "expected <2", "pip install 'numpy<2'"),
        ("no-such-thing>=1", WRONG, "no-such-thing is not installed", "pip install 'no-such-thing>=1'"),
        ('no-such-thing>=1; extra == "view"', NOTE, "extra 'view': no-such-thing not", "pip install 'hierax[view]'"),
    ],
)
def test_requirements(requirement: str, state: str, what: str, mend: str) -> None:
    (finding,) = check_packages([requirement])
    assert finding.state == state
    assert what in finding.what
    assert mend in finding.mend


def test_what_is_for_developers_is_not_looked_at() -> None:
    assert list(check_packages(['no-such-thing>=1; extra == "dev"'])) == []


def test_what_is_installed_but_cannot_be_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "msgpack.py").write_text("raise ImportError('libc.so.7: no such file')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (finding,) = check_packages(["msgpack>=1"])
    assert (finding.state, finding.what) == (WRONG, "msgpack cannot be imported: ImportError: libc.so.7: no such file")
    (tmp_path / "msgpack.py").write_text("import os; os._exit(3)")
    (finding,) = check_packages(["msgpack>=1"])
    assert finding.state == WRONG
    assert "ended with code 3" in finding.what
