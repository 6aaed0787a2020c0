"""A recorder beside a launch ends when the launch does, and not because a link broke for a moment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import pytest
from support.flawed import DEPLOYMENT
from support.recorded import record_file

from hierax.runtime.recording import live_recording
from hierax.runtime.recording.info import Ending
from hierax.runtime.recording.live_recording import LiveRecording
from hierax.runtime.recording.reading import Recording
from hierax.runtime.recording.recorder import Recorder
from hierax.runtime.transport.port import Sample, TransportError
from hierax.schemas.access import Access

EPOCHS = 12
LOOKS = range(1, 100)  # more than there are


class Launch:
    """A recorded run in a launch's place: an epoch is committed each time that somebody listens, and after the last one
    the launch is over. Only the first of them are `heard`, and some of the looks unanswered, by the session that
    listens; another one is answered while the launch is there."""

    def __init__(self, recording: Recording, heard: int = EPOCHS, unanswered: Collection[int] = ()) -> None:
        said = [(max(each.epoch, 1), Sample(each.time_ns, each.key, each.data)) for each in recording.entries()]
        self._said = [[sample for epoch, sample in said if epoch == wanted] for wanted in range(1, EPOCHS + 1)]
        self._heard, self._unanswered = heard, unanswered
        self._epoch = self._looks = 0
        self.asked_elsewhere = 0

    def told(self) -> Any:
        return {"epoch": self._epoch} if self._epoch < EPOCHS else None

    def wait(self, timeout_s: float) -> Sequence[Sample]:
        if self._epoch == EPOCHS:
            return ()
        self._epoch += 1
        return self._said[self._epoch - 1] if self._epoch <= self._heard else ()

    def dropped(self) -> Sequence[tuple[str, bytes]]:
        return ()

    def ask(self, question: Any) -> Any:
        self._looks += 1
        return None if self._looks in self._unanswered else self.told()

    def close(self) -> None:
        pass


class Client:
    """Another session, in which a launch answers while it is there."""

    def __init__(self, launch: Launch) -> None:
        self._launch = launch

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def ask(self, question: Any) -> Any:
        self._launch.asked_elsewhere += 1
        if self._launch.told() is None:
            raise TransportError("the launch does not answer")
        return self._launch.told()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recording")
    path = folder / "flawed.yaml"
    path.write_text(DEPLOYMENT, encoding="utf-8")
    return record_file(folder / "run.mcap", path)[0]


def recorded(recording: Recording, launch: Launch, patch: pytest.MonkeyPatch) -> Ending:
    """How a recording of it ends, by a recorder that looks each time that it listens."""
    patch.setattr(live_recording, "BusTap", lambda *reach: launch)
    patch.setattr(live_recording, "LaunchClient", lambda *reach: Client(launch))
    patch.setattr(live_recording, "LOOK_S", -1.0)
    patch.setattr(live_recording, "LINGER_S", 0.0)
    return LiveRecording(Recorder(recording.info, None), "tcp/nowhere:1", Access("world", {}), watches=True).record()


def test_a_look_that_is_not_answered_ends_nothing(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    launch = Launch(recording, unanswered=(3, 4))
    ending = recorded(recording, launch, monkeypatch)
    assert (ending.first, ending.last, ending.lost) == (1, EPOCHS, 0)
    assert launch.asked_elsewhere == 2 + 2  # and when it was over, twice


def test_nor_does_a_session_that_hears_and_is_never_answered(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    ending = recorded(recording, Launch(recording, unanswered=LOOKS), monkeypatch)
    assert (ending.first, ending.last, ending.lost) == (1, EPOCHS, 0)


@pytest.mark.parametrize("unanswered", [(), LOOKS], ids=["answered", "unanswered"])
def test_who_is_cut_off_ends_and_says_what_lacks(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, unanswered: Collection[int]
) -> None:
    launch = Launch(recording, heard=3, unanswered=unanswered)
    ending = recorded(recording, launch, monkeypatch)
    assert ending.last == 3
    assert "epoch 4: steps of world from here on" in {str(gap) for gap in ending.gaps}
    assert launch.told() is not None  # it goes on
