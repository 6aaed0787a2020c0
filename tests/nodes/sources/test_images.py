"""No image is decoded that has more pixels than is allowed, however its head is written."""

from __future__ import annotations

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
