"""Live sources: the newest frame, those passed over counted, and what stalls, breaks off and comes back."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.launched import until
from support.streams import Stream, number_of

from hierax.nodes.sources import live
from hierax.nodes.sources.camera import CameraWorld, picture_seen
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.live import Captured, Live
from hierax.nodes.sources.shots import CameraBelief, Seen, Shot

WAITING: Seen = {
    "index": 0,
    "frame": -1,
    "size": None,
    "time_s": 0.0,
    "wall_s": None,
    "passed_over": 0,
    "stalls": 0,
    "reopened": 0,
    "ended": False,
}
GREY = [np.full((240, 320, 3), 40 * level, np.uint8) for level in range(5)]
TIMEOUT_S = 0.5


def shown(belief: CameraBelief) -> int | None:
    pictures = picture_seen(belief)
    return number_of(pictures[0]["image"]) if pictures else None


def test_the_newest_frame_is_shown_and_those_before_it_are_counted() -> None:
    with Stream(GREY) as stream:
        world = CameraWorld(stream.url, source_timeout=20.0)
        belief = world.initial_belief()
        numbers, frames = [shown(belief)], [belief["frame"]]
        for _ in range(3):
            before = stream.sent
            until(lambda before=before: stream.sent > before + 5, "frames that nobody looks at")  # type: ignore[misc]
            belief = world.predict((), (), belief)
            numbers.append(shown(belief))
            frames.append(belief["frame"])
    assert all(number is not None for number in numbers)
    assert numbers == [numbers[0] - frames[0] + frame for frame in frames]  # type: ignore[operator]
    assert world.metrics(belief) == {"passed_over": belief["frame"] - 3.0, "stalls": 0.0, "reopened": 0.0}
    assert belief["passed_over"] >= 8
    assert not world.finished(belief)
    assert belief["time_s"] > 0.0
    assert belief["wall_s"] is not None


def test_an_epoch_done_again_takes_a_newer_frame_and_none_twice() -> None:
    with Stream(GREY) as stream:
        world = CameraWorld(stream.url, source_timeout=20.0)
        first = world.initial_belief()
        undone, done = (world.predict((), (), first) for _ in range(2))
        assert first["frame"] < undone["frame"] <= done["frame"]
        assert done["passed_over"] == done["frame"] - 1 - first["frame"] + first["passed_over"]
        after = world.predict((), (), done)
        other = CameraWorld(stream.url, source_timeout=20.0)  # as another process would
        again = other.predict((), (), after)
        numbers = [shown(each) for each in (first, done, after, again)]
        assert numbers == sorted(set(numbers)), numbers  # type: ignore[type-var]
        assert (again["frame"] > after["frame"], again["reopened"]) == (True, 1)


def test_what_stalls_or_breaks_off_is_opened_again(caplog: pytest.LogCaptureFixture) -> None:
    with Stream(GREY) as stream:
        world = CameraWorld(stream.url, source_timeout=TIMEOUT_S, reopen=True)
        belief = follow(world, world.initial_belief(), shows=True)
        last = shown(belief)
        for event in (stream.stalled, stream.refused):
            event.set()
            belief = follow(world, belief, shows=False)
            assert picture_seen(belief) == ()
            belief = follow(world, belief, shows=False)
            stalls, frame = belief["stalls"], belief["frame"]
            event.clear()
            belief = follow(world, belief, shows=True)
            assert belief["stalls"] >= stalls >= 2
            assert belief["frame"] > frame
            assert world._source()._fault == ""  # type: ignore[attr-defined]  # what is over explains no later stall
            number = shown(belief)
            assert number is not None
            assert last is not None
            assert number > last
            last = number
        assert belief["reopened"] >= 1
        assert "no frame; nothing is observed until one comes" in caplog.text
        assert "frames come again" in caplog.text


def follow(world: CameraWorld, belief: CameraBelief, shows: bool) -> CameraBelief:
    """The belief after which a frame is there, or none is."""
    for _ in range(200):
        belief = world.predict((), (), belief)
        if (belief["image"] is not None) == shows:
            return belief
    raise AssertionError(f"expected {'a' if shows else 'no'} frame within 200 epochs")


@pytest.mark.parametrize(
    ("event", "told"),
    [
        ("stalled", r"no frame for 0.5 s; expected one within source_timeout"),
        ("refused", r"gives no more frames; it has ended, or was unplugged"),
    ],
)
def test_without_reopening_it_is_an_error(event: str, told: str) -> None:
    with Stream(GREY) as stream:
        world = CameraWorld(stream.url, source_timeout=TIMEOUT_S)
        belief = follow(world, world.initial_belief(), shows=True)
        getattr(stream, event).set()
        with pytest.raises(DataError, match=re.escape(f"camera {stream.url}: ") + told):
            follow(world, belief, shows=False)


def test_a_camera_that_changes_its_size_is_refused_with_both_sizes() -> None:
    pictures: list[Array] = list(GREY)
    with Stream(pictures) as stream:
        world = CameraWorld(stream.url, source_timeout=20.0)
        belief = world.initial_belief()
        stream.refused.set()
        pictures[:] = [np.zeros((480, 640, 3), np.uint8)] * len(pictures)
        other = CameraWorld(stream.url, source_timeout=20.0)
        stream.refused.clear()
        with pytest.raises(DataError, match=re.escape("has 640×480 pixels; expected 320×240")):
            other.predict((), (), belief)


def test_what_cannot_be_opened_is_told() -> None:
    for source in ("http://127.0.0.1:9/none", 83):
        world = CameraWorld(source, source_timeout=TIMEOUT_S)
        with pytest.raises(DataError, match=rf"camera {source}: .*\(reopen: true waits for it\)"):
            world.initial_belief()
    waiting = CameraWorld("http://127.0.0.1:9/none", source_timeout=0.1, reopen=True)
    belief = waiting.initial_belief()
    assert (picture_seen(belief), belief["stalls"], belief["reopened"]) == ((), 1, 0)


def test_a_device_has_a_number_or_a_path(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="camera /dev/null: cannot be opened"):
        CameraWorld("/dev/null", source_timeout=5.0).initial_belief()


def test_a_size_that_changes_under_way_is_an_error_or_opens_the_camera_again() -> None:
    pictures: list[Array] = list(GREY)
    with Stream(pictures) as stream:
        strict, patient = (CameraWorld(stream.url, source_timeout=20.0, reopen=reopen) for reopen in (False, True))
        beliefs = [strict.initial_belief(), patient.initial_belief()]
        pictures[:] = [np.zeros((480, 640, 3), np.uint8)] * len(pictures)
        with pytest.raises(DataError, match=re.escape("has 640×480 pixels; expected 320×240")):
            follow(strict, beliefs[0], shows=False)
        waiting = CameraWorld(stream.url, source_timeout=TIMEOUT_S, reopen=True)
        after = follow(waiting, beliefs[1], shows=False)
        pictures[:] = GREY
        again = follow(waiting, after, shows=True)
    assert again["size"] == (320, 240)
    assert again["reopened"] >= 2


def test_a_damaged_frame_is_left_out_with_a_word(caplog: pytest.LogCaptureFixture) -> None:
    with Stream(GREY) as stream:
        world = CameraWorld(stream.url, source_timeout=20.0)
        belief = world.initial_belief()
        stream.cut.set()
        until(lambda: "cut off; expected a whole JPEG image; the frame is left out" in caplog.text, "a word")
        stream.cut.clear()
        assert shown(world.predict((), (), belief)) is not None


def test_a_source_may_be_closed_by_its_own_thread_and_before_it_was_asked() -> None:
    class Held(Live):
        def _stream(self) -> str:
            self.close()  # as where the collector of garbage runs in this thread
            return "was closed by itself"

    for held in (Held("held", 20.0, False), Held("held", 20.0, False)):
        with pytest.raises(DataError, match="held: was closed by itself"):
            held.shot(WAITING)
    Held("held", 20.0, False).close()


class Failing(Live):
    """Fails as libraries do, and goes well when it is opened again."""

    def _stream(self) -> str:
        self._opened += 1
        if not self._opened:
            raise RuntimeError("rcl says no\nat length")
        self._take(Shot(0, GREY[0], 1.0))
        self._closed.wait()
        return "was closed"


def test_whatever_a_library_raises_is_told_or_has_the_source_opened_again() -> None:
    with pytest.raises(DataError, match=re.escape("rig: RuntimeError: rcl says no (reopen: true waits for it)")):
        Failing("rig", 20.0, False).shot(WAITING)
    again = Failing("rig", 20.0, True)
    assert (again.shot(WAITING).frame, again._opened) == (0, 1)
    again.close()


def test_a_timeout_of_months_is_one_that_opencv_takes() -> None:
    with pytest.raises(DataError, match="none: cannot be opened"):
        Captured("http://127.0.0.1:9/none", 3e6, False).shot(WAITING)


def test_a_long_wait_is_told_early(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "PATIENCE_S", 0.2)
    world = CameraWorld("http://127.0.0.1:9/none", source_timeout=1.0, reopen=True)
    world.initial_belief()
    told = "camera http://127.0.0.1:9/none: cannot be opened; expected a device's number, a file, a folder, or a"
    assert told in caplog.text
    assert "it is waited for until source_timeout, 1 s" in caplog.text


@pytest.mark.parametrize(
    ("target", "name"),
    [
        ("rtsp://me:secret@127.0.0.1:9/live/1", "camera rtsp://127.0.0.1:9/live/1"),
        ("http://me:se:@cret@[::1]:9", "camera http://[::1]:9"),
        ("http://127.0.0.1:9/live?user=me&pwd=secret@x", "camera http://127.0.0.1:9/live?…"),
        ("http://127.0.0.1:9/@live", "camera http://127.0.0.1:9/@live"),
        ("/dev/video0", "camera /dev/video0"),
        (0, "camera 0"),
    ],
)
def test_what_is_opened_is_told_without_its_secrets(target: int | str, name: str) -> None:
    assert Captured(target, 1.0, False).name == name
