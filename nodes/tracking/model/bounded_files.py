"""Files of a scene as bytes: bounded, and nothing but files."""

from __future__ import annotations

import struct
from pathlib import Path

from hierax.nodes.tracking.errors import DataError

MAX_FILE_BYTES = 1 << 26  # of a model, an image or a JSON file
MAX_PIXELS = 1 << 25  # of an image: a small file may unpack to gigabytes


def read_file(path: Path, expected: str) -> bytes:
    """What is in a file. Raises DataError, which says what was expected: it is missing, no file, or too large."""
    try:
        if path.exists() and not path.is_file():  # reading a FIFO waits for ever
            raise DataError(f"{path}: is no file; expected {expected}")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file; expected {expected}") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}; expected {expected}") from error
    if len(data) > MAX_FILE_BYTES:
        raise DataError(f"{path}: has more than {MAX_FILE_BYTES} bytes; expected {expected} of at most that")
    return data


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height as an image's head has them: PNG, JPEG, BMP, PNM and TIFF; None where it has none."""
    try:
        if data.startswith(b"\x89PNG"):
            return struct.unpack_from(">II", data, 16)
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith(b"\xff\xd8"):
            return _jpeg_size(data)
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _tiff_size(data, "<" if data.startswith(b"II") else ">")
        if data[:2] in (b"P2", b"P3", b"P5", b"P6"):
            words = [line.split(b"#")[0] for line in data[2:4096].splitlines()]
            width, height = (int(word[:9]) for word in b" ".join(words).split()[:2])
            return width, height
    except (struct.error, ValueError, IndexError):
        return None
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 < len(data):
        marker, length = struct.unpack_from(">HH", data, at)
        if 0xFFC0 <= marker <= 0xFFCF and marker not in (0xFFC4, 0xFFC8, 0xFFCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + length
    return None


def _tiff_size(data: bytes, order: str) -> tuple[int, int] | None:
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    sizes: dict[int, int] = {}
    for entry in range(count):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * entry)
        if tag in (256, 257):
            sizes[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * entry)[0]
    return (sizes[256], sizes[257]) if len(sizes) == 2 else None
