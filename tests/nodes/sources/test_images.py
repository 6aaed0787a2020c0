"""No image is decoded that has more pixels than is allowed, however its head is written, or that is cut off; and what
is read ahead holds nobody up."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest

from hierax.nodes.sources import images
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.images import decode_image

PICTURE = np.zeros((30, 40), np.uint8)


def encoded(suffix: str) -> bytes:
    return bytes(cv2.imencode(suffix, PICTURE)[1])


def jpeg_with(extra: bytes) -> bytes:
    """A JPEG with something in front of the marker that tells its size."""
    return encoded(".jpg").replace(b"\xff\xc0", extra + b"\xff\xc0", 1)


HEADS = {
    "filled": jpeg_with(b"\xff\xff"),
    "marker without a length": jpeg_with(b"\xff\x01"),
    "extraneous bytes": jpeg_with(b"\0\0\xff\0"),
    "packed bits": b"P4\n# 1 1\n40 30\n" + bytes(5 * 30),
    "bits as text": b"P1\n40 30\n" + b"0 " * 1200,
    "zeros in front": b"P5\n" + b"0" * 12 + b"40 30\n255\n" + bytes(1200),
}


@pytest.mark.parametrize("name", HEADS)
def test_the_bound_of_pixels_is_kept_before_anything_is_decoded(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert decode_image("x", HEADS[name]).shape == (30, 40)
    monkeypatch.setattr(images, "MAX_PIXELS", 1199)
    monkeypatch.setattr(images.cv2, "imdecode", None)
    with pytest.raises(DataError, match="x: has 40×30 pixels; expected at most 1199 in all"):
        decode_image("x", HEADS[name])


@pytest.mark.parametrize("data", [encoded(".webp"), b"", b"P4\nx"])
def test_an_image_whose_head_tells_no_size_is_refused(data: bytes) -> None:
    with pytest.raises(DataError, match="x: cannot be decoded; expected an image: PNG, JPEG, TIFF, BMP or PNM"):
        decode_image("x", data)


def test_a_size_that_the_head_did_not_tell_is_refused_after_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(images, "MAX_PIXELS", 1199)
    monkeypatch.setattr(images, "image_size", lambda data: (1, 1))
    with pytest.raises(DataError, match="x: has 40×30 pixels; expected at most 1199 in all"):
        decode_image("x", encoded(".png"))


SEED = 5
NOISE = np.random.default_rng(SEED).integers(0, 256, (60, 80, 3), np.uint8)
THUMBNAIL = b"Exif\0\0" + encoded(".jpg")


def noisy(suffix: str, *options: int) -> bytes:
    return bytes(cv2.imencode(suffix, NOISE, options)[1])


WHOLE = {
    "JPEG": noisy(".jpg"),
    "JPEG in scans": noisy(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "JPEG with restarts": noisy(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
    "JPEG with a thumbnail": b"\xff\xd8\xff\xe1"
    + (len(THUMBNAIL) + 2).to_bytes(2, "big")
    + THUMBNAIL
    + noisy(".jpg")[2:],
    "PNG": noisy(".png"),
}
BEHIND = {
    "nothing": b"",
    "a video": b"\0\0\0\x18ftypmp42" + bytes(5000),
    "another": encoded(".jpg"),
    "junk": b"\xff" * 2000,
}


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("behind", BEHIND)
def test_what_stands_behind_an_image_is_nobodys_matter(name: str, behind: str) -> None:
    shown = decode_image("x", WHOLE[name] + BEHIND[behind])
    np.testing.assert_array_equal(shown, decode_image("x", WHOLE[name]))
    assert shown.shape == NOISE.shape


@pytest.mark.parametrize("name", WHOLE)
def test_an_image_that_is_cut_off_is_refused_wherever_that_is(name: str) -> None:
    data = WHOLE[name]
    for end in {*range(4, len(data), 61), *range(len(data) - 20, len(data))}:
        with pytest.raises(DataError, match=f"x: cut off; expected a whole {name.split()[0]} image"):
            decode_image("x", data[:end])


READ_ON = """
import threading
from hierax.nodes.sources.images import ReadAhead

begun = threading.Event()

def read(place):
    print(place, flush=True)
    if place:
        begun.set()
        threading.Event().wait()

ReadAhead(range(9), read).read(0)
begun.wait()
RAISED
"""


@pytest.mark.parametrize(("raised", "code"), [("", 0), ("raise KeyboardInterrupt", -2)])
def test_a_process_ends_while_it_reads_ahead(raised: str, code: int) -> None:
    """What is asked for further on is not read any more, and what is being read may never come."""
    program = [sys.executable, "-c", READ_ON.replace("RAISED", f"images = ReadAhead(range(9), read)\n{raised}")]
    done = subprocess.run(program, capture_output=True, text=True, timeout=20, check=False)
    assert (done.returncode, done.stdout.split()) == (code, ["0", "1"]), done.stderr
