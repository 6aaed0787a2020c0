"""A recorder in a process of its own, beside a launch; also as `hierax record` runs it.

Started by a supervisor with its order, a JSON object, as the first line of standard input. Others may follow: with
which certificate it is to go on, and, when the run is over, which was its last epoch, where that is known. End of file
there means that it is over, too. What it has to say goes to standard output as JSON objects, one a line."""

import json
import logging
import os
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import own_streams
from hierax.runtime.recording.info import Ending, RunInfo
from hierax.runtime.recording.recorder import Recorder
from hierax.runtime.recording.topics import Selection
from hierax.runtime.recording.writing import Target
from hierax.runtime.transport.bus_tap import BusTap
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.watch.logs import log_console
from hierax.schemas.access import Access
from hierax.schemas.keys import Keys

BATCH_S = 0.05  # how long what is heard may wait to be written
LINGER_S = 10.0  # how long what was said, by the words of others, may still be on its way at the end
QUIET_S = 1.0  # with rates: how long nothing may come at the end before it is the end
LOOK_S = 1.0
CUT_OFF_LOOKS = 5
"""How often the launch is asked; how often in a row it has to be further, and nothing come, for a recorder to end."""

RENEW, LAST = "renew", "last"
"""What it is told: go on with the certificate in this secret; the run is over, with this epoch, or null."""

LISTENING, RENEWED, DONE, FAILED = "listening", "renewed", "done", "failed"
"""What it says: it hears all from now on; it shows the new certificate; how the recording ended; why there is none."""

_HOW_FAR = {"ask": "ps"}

_log = logging.getLogger("hierax")

_saying = threading.Lock()


class LiveRecording:
    """A recorder at work: hears a run of an endpoint's hub, until it is told to stop. The settings are Zenoh's own, the
    secret is the run's, which says who has roles of their own in it (`access`), and it `watches` where nobody else
    tells when the launch is over, and how far it came. Raises `HieraxError` if the run cannot be reached."""

    def __init__(
        self,
        recorder: Recorder,
        endpoint: str,
        access: Access,
        settings: Any = None,
        watches: bool = False,
        secret: str = "",
    ) -> None:
        self._recorder = recorder
        self._keys = Keys(recorder.info.hierarchy, recorder.info.run)
        self._ear = BusTap(endpoint, self._keys, access, settings, secret)
        self._reach = (endpoint, settings, self._keys, secret)
        self._stopping = False
        self._last: int | None = None
        self._watches = watches
        self._silent = self._before = 0

    def stop(self, last: int | None = None) -> None:
        """Come to the end, from any thread; `last` is the run's last epoch, or None where nobody knows."""
        if last is not None:
            self._last = last
        self._stopping = True

    def renew(self, secret: str) -> bool:
        """Go on with another certificate, from any thread; whether that was before the end."""
        try:
            return self._ear.renew(secret)
        except HieraxError as error:
            _log.warning("the recorder's certificate is not renewed: %s", error)
            return False

    def record(self) -> Ending:
        """Hear and write until `stop`, the last wanted epoch, or the launch's end; `RecordingError` as `Recorder`."""
        recorder, ledger = self._recorder, self._recorder.ledger
        looked_s = time.monotonic()
        try:
            # the order is checked further where nothing more is written
            while not (self._stopping or (ledger.ended and not (recorder.checker is not None and recorder.cut))):
                self._take(BATCH_S)
                recorder.flush()
                if self._watches and time.monotonic() - looked_s > LOOK_S:
                    self._look()
                    looked_s = time.monotonic()
            if self._watches and not ledger.ended:
                self._look()
            self._linger()
        finally:
            self._ear.close()
        self._take(0.0)
        return recorder.finish(self._last if ledger.cut is None or not ledger.ended else ledger.cut)

    def _look(self) -> None:
        """How far the launch is, by its supervisor's words: a recorder that is cut off hears nothing, and not that."""
        said = self._asked()
        if said is None:
            self._stopping = True  # it is over
            return
        heard = self._recorder.ledger.last
        behind = heard < (self._last or 0)
        self._silent = self._silent + 1 if behind and heard == self._before else 0
        self._before = heard
        self._last = said
        if self._silent >= CUT_OFF_LOOKS:
            self._stopping = True

    def _asked(self) -> int | None:
        """The last epoch by the supervisor's words; None: it answers neither in the session that listens, which may be
        cut off, or its link have broken just now, nor in another one."""
        said = _epoch_of(self._ear.ask(_HOW_FAR))
        if said is None:
            with suppress(HieraxError), LaunchClient(*self._reach) as client:
                said = _epoch_of(client.ask(_HOW_FAR))
        return said

    def _take(self, wait_s: float) -> bool:
        heard = self._ear.wait(wait_s)
        for each in heard:
            self._recorder.take(each)
        for key, data in self._ear.dropped():
            self._recorder.drop(key, data)
        return bool(heard)

    def _linger(self) -> None:
        """What was told by the last steps may still be on its way along other links."""
        ledger = self._recorder.ledger
        self._take(0.0)
        if ledger.cut is None:
            ledger.end(max(ledger.last, self._last or 0))
        begun_s = quiet_s = time.monotonic()
        while not ledger.complete and time.monotonic() - begun_s < LINGER_S:
            if self._take(BATCH_S):
                quiet_s = time.monotonic()
            # with rates, not everybody tells of the last epoch; else who has not yet may be slow
            if ledger.rated and ledger.settled and ledger.ended and time.monotonic() - quiet_s > QUIET_S:
                return


def _epoch_of(said: Any) -> int | None:
    """The last epoch by a supervisor's words; None: it says none."""
    epoch = said.get("epoch") if isinstance(said, dict) else None
    return epoch if isinstance(epoch, int) else None


def main() -> int:
    """Read the order, record, say how it ended."""
    own_streams()
    log_console()
    order = json.loads(sys.stdin.readline() or "{}")
    if not order:
        return 0
    try:
        info, selection = RunInfo.read(order["info"]), Selection(**order["selection"])
        file = Target(Path(order["file"]), order["descriptor"]) if order["file"] else None
        recorder = Recorder(info, file, order["check"], selection)
        access = Access.read(order["access"])
        recording = LiveRecording(recorder, order["endpoint"], access, order["settings"], secret=order["secret"])
        _say({"status": LISTENING})
        threading.Thread(target=_obey, args=(recording,), daemon=True).start()
        ending = recording.record()
    except HieraxError as error:
        _say({"status": FAILED, "why": str(error)})
        return 1
    violations = [] if recorder.checker is None else [str(each) for each in recorder.checker.close()]
    _say({"status": DONE, "ending": ending.plain(), "violations": violations})
    return 0


def _obey(recording: LiveRecording) -> None:
    for line in sys.stdin:
        told = json.loads(line)
        if LAST in told:
            recording.stop(told[LAST])
        else:  # it takes a while, and the end does not wait for it
            threading.Thread(target=_renew, args=(recording, told[RENEW]), daemon=True).start()
    recording.stop()


def _renew(recording: LiveRecording, secret: str) -> None:
    if recording.renew(secret):
        _say({"status": RENEWED})


def _say(value: Mapping[str, Any]) -> None:
    with _saying:
        print(json.dumps(value), flush=True)


if __name__ == "__main__":
    sys.stdout.flush()
    os._exit(main())  # Zenoh's threads may hold the interpreter up
