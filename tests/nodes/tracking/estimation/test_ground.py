"""What a table's texture tells of a camera, by pictures of one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE
from support.tables import table_seen

from hierax.nodes.tracking.estimation.fusion import Rows
from hierax.nodes.tracking.estimation.ground import View, corrected, covered_by, ground_of, told_by
from hierax.nodes.tracking.math.geometry import exp_se3, invert, log_se3, looking_down

OLDER = looking_down(0.4, 0.7, 0.45, np.zeros(3))
NEWER = looking_down(0.7, 0.6, 0.45, np.zeros(3))
ERROR = np.array([0.002, -0.001, 0.0015, 0.002, -0.003, 0.0015])
FREE = np.zeros((-(-SIZE[1] // 8), -(-SIZE[0] // 8)), dtype=np.uint8)
LOOSE, TIGHT = np.diag([0.003**2] * 3 + [0.005**2] * 3), np.diag([1e-6**2] * 3 + [1e-6**2] * 3)


def picture(camera: np.ndarray[Any, Any], seed: int = 1) -> np.ndarray[Any, Any]:
    """A table's, with noise."""
    noise = 1.5 * np.random.default_rng(seed).normal(size=SIZE[::-1])
    return np.clip(table_seen(camera) + noise, 0, 255).astype(np.uint8)


def texture(covered: np.ndarray[Any, Any] = FREE) -> dict[str, Any]:
    """What is known of the table from the older image."""
    ground = ground_of(View(picture(OLDER), OLDER, INTRINSICS), covered)
    assert ground is not None
    return {"covered": covered, "ground": ground, "alike": 1.0}


def joint(newer: np.ndarray[Any, Any], older: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Covariance of no objects, and of both cameras."""
    whole = np.zeros((18, 18))
    whole[Rows.drift, Rows.drift] = 1e-6 * np.eye(6)
    whole[Rows.error, Rows.error] = newer
    whole[12:, 12:] = older
    return whole


def seen(error: np.ndarray[Any, Any], **given: Any) -> View:
    """The newer image, whose camera is expected with an error: its poses are those after ``exp(error)``."""
    return View(given.get("image", picture(NEWER, 2)), NEWER @ exp_se3(error), INTRINSICS)


def test_a_camera_is_where_the_texture_has_it() -> None:
    told = told_by(seen(ERROR), texture(), joint(LOOSE, TIGHT))
    assert told.known.mean is not None
    assert told.known.joint is not None
    np.testing.assert_allclose(told.known.mean[Rows.error], ERROR, atol=2e-4)
    assert np.sqrt(np.diag(told.known.joint)[Rows.error]).max() < 0.001
    assert told.known.older == slice(12, 18)


def test_of_two_cameras_that_are_not_known_tilts_are_told_and_heights_are_not() -> None:
    told = told_by(seen(ERROR), texture(), joint(LOOSE, LOOSE))
    assert told.known.joint is not None
    up = [np.concatenate((camera[2, :3], np.zeros(3))) for camera in (NEWER, OLDER)]
    across = np.concatenate((np.zeros(3), np.cross(NEWER[2, :3], (1.0, 0.0, 0.0))))
    after = told.known.joint
    height, tilt = (float(np.sqrt(way @ after[Rows.error, Rows.error] @ way)) for way in (up[0], across))
    assert height > 0.0015
    assert tilt < 0.002
    # But both heights go together.
    both = float(up[0] @ after[Rows.error, 12:] @ up[1]) / (height * float(np.sqrt(up[1] @ after[12:, 12:] @ up[1])))
    assert both > 0.9


def test_what_is_moved_is_left_out() -> None:
    """A third of the table is a sheet that somebody has pulled by some pixels."""
    image = picture(NEWER, 2)
    image[:, : SIZE[0] // 3] = np.roll(image, 3, axis=1)[:, : SIZE[0] // 3]
    told = told_by(seen(ERROR, image=image), texture(), joint(LOOSE, TIGHT))
    assert told.known.mean is not None
    np.testing.assert_allclose(told.known.mean[Rows.error], ERROR, atol=4e-4)


def test_where_bodies_are_expected_no_texture_is_looked_at() -> None:
    covered = FREE.copy()
    covered[:, : FREE.shape[1] // 2] = 1
    points = texture(covered)["ground"]["points"]
    assert points[:, 0].min() >= SIZE[0] // 2
    labels = np.zeros((40, 40), dtype=np.uint8)
    labels[8:16, 16:24] = 3
    imagery: Any = {"labels": labels, "corner": (80, 40), "size": SIZE}
    rows, columns = np.nonzero(covered_by(imagery))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (4, 8, 10, 14)


@pytest.mark.parametrize("kind", ["noise", "nothing", "elsewhere"])
def test_what_is_no_texture_says_nothing_and_is_not_kept(kind: str) -> None:
    rng = np.random.default_rng(3)
    images = {
        "noise": np.clip(110 + rng.normal(size=SIZE[::-1]), 0, 255).astype(np.uint8),
        "nothing": np.full(SIZE[::-1], 110, dtype=np.uint8),
        "elsewhere": picture(looking_down(2.5, 0.6, 0.45, np.array([0.5, 0.5, 0.0])), 2),
    }
    known = texture()
    told = told_by(seen(ERROR, image=images[kind]), known, joint(LOOSE, TIGHT))
    assert told.known.mean is None
    if kind == "nothing":
        assert (told.ground, told.known.older) == (known["ground"], slice(12, 18))
    else:
        assert told.known.older == Rows.error  # another image's from then on


def test_a_picture_in_colour_tells_the_same() -> None:
    gray = picture(NEWER, 2)
    coloured = told_by(seen(ERROR, image=np.repeat(gray[:, :, None], 3, axis=2)), texture(), joint(LOOSE, TIGHT))
    plain = told_by(seen(ERROR, image=gray), texture(), joint(LOOSE, TIGHT))
    np.testing.assert_array_equal(coloured.known.mean, plain.known.mean)


def test_pictures_of_another_size_have_no_older_one() -> None:
    small = picture(NEWER)[: SIZE[1] // 2, : SIZE[0] // 2]
    told = told_by(seen(ERROR, image=np.ascontiguousarray(small)), texture(), joint(LOOSE, TIGHT))
    assert (told.ground, told.known.mean, told.known.older) == (None, None, None)


def test_a_table_seen_from_below_or_behind_the_camera_says_nothing() -> None:
    known = texture()
    below = NEWER.copy()
    below[2, 3] = -0.1
    told = told_by(View(picture(NEWER), below, INTRINSICS), known, joint(LOOSE, TIGHT))
    assert (told.ground, told.known.mean) == (None, None)
    away = looking_down(0.4, -0.5, 0.45, np.array([0.0, 0.0, 1.0]))  # upwards, the points behind it
    told = told_by(View(picture(NEWER), away, INTRINSICS), known, joint(LOOSE, TIGHT))
    assert told.known.mean is None


def test_a_straight_edge_tells_what_is_across_it() -> None:
    """Black and white halves have no slope along their border; nothing but that is told, and nothing fails."""
    shades = np.where(np.arange(SIZE[0]) < SIZE[0] // 2, 20, 230).astype(np.uint8)
    image = np.broadcast_to(shades, SIZE[::-1]).copy()
    column = np.full(16, SIZE[0] // 2)
    points = np.stack((column, np.linspace(40, SIZE[1] - 40, 16).astype(np.int64)), axis=1)
    patches = np.stack([image[y - 20 : y + 21, x - 20 : x + 21] for x, y in points])
    known: Any = {"covered": FREE, "ground": {"camera": OLDER, "points": points, "patches": patches}, "alike": 1.0}
    told = told_by(View(image, OLDER, INTRINSICS), known, joint(LOOSE, TIGHT))
    assert told.known.joint is not None
    after, before = (np.diag(each)[Rows.error] for each in (told.known.joint, joint(LOOSE, TIGHT)))
    assert np.isfinite(told.known.joint).all()
    assert (after < 1.001 * before).all()
    assert after.min() < 0.5 * before.min()


def test_an_older_camera_is_corrected_and_a_newer_one_is_where_the_image_has_it() -> None:
    ground = texture()["ground"]
    np.testing.assert_array_equal(corrected(ground, NEWER, True, ERROR)["camera"], NEWER)
    after = corrected(ground, NEWER, False, ERROR)["camera"]
    np.testing.assert_allclose(log_se3(invert(after) @ OLDER), ERROR, atol=1e-12)
