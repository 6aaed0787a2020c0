"""Processes whose certificates hold for seconds go on in other sessions, with new ones, and no epoch is lost."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from support.live import Live, hierax, renewed, until

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
