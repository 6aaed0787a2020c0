from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from hierax.runtime.commands.main import main
from hierax.runtime.tools import doctor
from hierax.runtime.tools.doctor import FINE, WRONG, Finding

FOUND = [Finding("python", FINE, "Python 3.11"), Finding("limits", WRONG, "12 open files", "ulimit -n 1024")]


@pytest.fixture
def findings(monkeypatch: pytest.MonkeyPatch) -> list[Finding]:
    found = list(FOUND)

    def examine() -> Iterator[Finding]:
        return iter(found)

    monkeypatch.setattr(doctor, "examine", examine)
    return found


def test_what_is_wrong_is_told_with_how_to_mend_it(findings: list[Finding], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "fine   python: Python 3.11",
        "wrong  limits: 12 open files",
        "       -> ulimit -n 1024",
        "1 wrong",
    ]
    assert main(["doctor", "--format", "json"]) == 1
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert (told["wrong"], told["mended"], len(told["findings"])) == (1, [], 2)


def test_a_sound_machine(findings: list[Finding], capsys: pytest.CaptureFixture[str]) -> None:
    findings.pop()
    assert main(["doctor"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "nothing is wrong"


def test_mending_says_what_was_done(
    findings: list[Finding], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "mend", lambda: ["removed /tmp/hierax-0c18adfc"])
    assert main(["doctor", "--mend"]) == 1
    assert capsys.readouterr().out.splitlines()[0] == "removed /tmp/hierax-0c18adfc"


def test_this_machine_can_be_examined(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--format", "json"]) in (0, 1)
    checks = {finding["check"] for finding in json.loads(capsys.readouterr().out)["findings"]}
    assert {"python", "system", "package", "cores", "limits", "shared memory", "network", "leftovers"} <= checks
