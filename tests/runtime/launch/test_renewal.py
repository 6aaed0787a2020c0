"""Processes whose certificates hold for seconds go on in other sessions, with new ones, and no epoch is lost."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from support.launched import processes_of
from support.live import Live, hierax, renewed, until

from hierax.runtime.host.run_secret import issued
from hierax.runtime.transport.launch_client import AnswerError, LaunchClient
from hierax.schemas.access import OPERATOR

LIFETIME_S = 20
RENEWALS = 4  # a third of the lifetime apart: links with the first certificates have ended by then


def test_certificates_are_renewed_while_epochs_go_on(tmp_path: Path) -> None:
    file = tmp_path / "live.mcap"
    short = ("--set", f"certificates_s={LIFETIME_S}", "--processes", "2")
    live = Live(tmp_path, "--host", "127.0.0.1", "--record", str(file), *short)
    try:
        path = live.snippet("top", "high")
        epoch = live.change("attach", path)
        processes = 3  # two for the nodes of the file, and that of the new one
        enough = [RENEWALS] * processes
        until(lambda: sorted(renewed(live).values()) >= enough, "new certificates", 20 * LIFETIME_S)
        os.kill(live.run["nodes"]["low"]["pid"], signal.SIGKILL)
        live.goes_on()
        before = renewed(live)
        until(lambda: len(renewed(live) - before) >= processes, "more of them", 20 * LIFETIME_S)
        live.is_repeated_by(f"{epoch}:attach:{path}")
    finally:
        live.close()
    said = hierax(tmp_path, "replay", str(file), "--verify")
    assert (said.returncode, "all results are alike" in said.stdout) == (0, True), said.stderr
    told = "".join(live.launch.err)
    assert "has not got another certificate" not in told
    assert "has no certificate of this run" not in told


def test_so_are_those_of_nodes_that_somebody_else_keeps(tmp_path: Path) -> None:
    live = Live(tmp_path, "--host", "127.0.0.1", "--set", f"certificates_s={LIFETIME_S}", "--processes", "2")
    key, path = tmp_path / "operator.key", live.snippet("top", "high")
    try:
        assert live.hierax("keys", str(key), "--role", "operator").returncode == 0
        where = ("--connect", live.endpoint, "--key", str(key), "--here", "--host", "127.0.0.1")
        keeper = live.start("attach", path, "--deployment", str(live.file), *where)
        epoch = int(keeper.says("attached top at epoch").split()[-1])
        until(lambda: renewed(live)["top"] >= RENEWALS, "new certificates", 20 * LIFETIME_S)
        live.goes_on()
        os.kill(processes_of(keeper.process.pid)[0], signal.SIGKILL)  # the next one has no certificate that has ended
        live.goes_on()
        before = renewed(live)["top"]
        until(lambda: renewed(live)["top"] > before, "another one", 20 * LIFETIME_S)
        live.is_repeated_by(f"{epoch}:attach:{path}")
        assert keeper.ends() == 0, keeper.err
        assert not any("certificate" in line for line in keeper.err), keeper.err
    finally:
        live.close()


def test_nobody_gets_one_of_a_process_that_the_launch_keeps(tmp_path: Path) -> None:
    live = Live(tmp_path, "--host", "127.0.0.1", "--set", f"certificates_s={LIFETIME_S}")
    question = {"ask": "renew", "name": "low", "host": "127.0.0.1"}
    try:
        with LaunchClient(live.endpoint, secret=issued(live.secret, OPERATOR)) as client:
            for process in (live.run["nodes"]["low"]["process"], "low~other"):
                with pytest.raises(AnswerError, match="the launch counts on no such process that others keep"):
                    client.ask({**question, "process": process})
            with pytest.raises(AnswerError, match="expected the name of a node, its process, and an address"):
                client.ask(question)
    finally:
        live.close()
