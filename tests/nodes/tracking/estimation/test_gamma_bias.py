"""Pictures that encode light: how far that moves edges is learned from objects, and is no longer the poses' error."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.boxes import INTRINSICS, SIZE, Box, cast
from support.drawn import all_expected

from hierax.nodes.tracking.estimation.gamma_bias import UNTOLD, USUAL_PX, believed, remembered
from hierax.nodes.tracking.estimation.profiles import smoothed
from hierax.nodes.tracking.math.geometry import exp_so3, make_pose, pose_error
from hierax.nodes.tracking.search.association import Options, associate

OPTIONS = Options(np.diag([0.01**2] * 3 + [0.06**2] * 3), 0.7, 0.75)
FIRST = Box(1, (0.08, 0.07, 0.09), make_pose(exp_so3(np.array([0.5, 0.6, 0.1])), [-0.07, -0.01, 0.5]))
SECOND = Box(2, (0.06, 0.09, 0.07), make_pose(exp_so3(np.array([0.7, -0.4, 0.3])), [0.08, 0.02, 0.55]))
PAIR = (FIRST, SECOND)
SHADES = np.array([[90.0] * 6, [30.0, 220.0, 40.0, 200.0, 230.0, 20.0], [220.0, 30.0, 210.0, 25.0, 40.0, 235.0]])
POWER = 2.2


def picture(encoded: bool) -> np.ndarray:
    """Boxes of which each has bright and dark sides, before gray; light is averaged, then encoded or not."""
    factor = 3
    fx, fy, cx, cy = INTRINSICS
    fine = np.array([fx * factor, fy * factor, factor * (cx + 0.5) - 0.5, factor * (cy + 0.5) - 0.5])
    seen = cast(PAIR, fine, (SIZE[0] * factor, SIZE[1] * factor))
    shade = SHADES[seen.labels, seen.faces] / 255.0
    if encoded:
        shade = shade**POWER
    image = cv2.GaussianBlur(shade.reshape(SIZE[1], factor, SIZE[0], factor).mean(axis=(1, 3)), (5, 5), 0.5)
    return 255.0 * (image ** (1.0 / POWER) if encoded else image)


def followed(encoded: bool, images: int) -> tuple[list[float], list[float]]:
    """The factor that is believed after each image, and the larger error of both distances there, millimetres."""
    items = all_expected(PAIR, [box.pose for box in PAIR])
    drawn = picture(encoded)
    factors, errors = [], []
    for seed in range(images):
        noise = np.random.default_rng(seed).standard_normal(drawn.shape)
        image = smoothed(np.clip(drawn + noise, 0, 255).astype(np.uint8))
        found = associate(image, items, None, INTRINSICS, OPTIONS)
        assert found is not None
        items = [{**item, "slots": each.slots} for item, each in zip(items, found[1], strict=True)]
        factors.append(believed([item["slots"]["encoding"] for item in items])[0])
        errors.append(max(1e3 * pose_error(each.pose, box.pose)[0] for each, box in zip(found[1], PAIR, strict=True)))
    return factors, errors


@pytest.mark.parametrize("encoded", [True, False])
def test_the_factor_is_learned_from_edges_that_are_bright_inside_and_others_that_are_dark(encoded: bool) -> None:
    factors, errors = followed(encoded, 5)
    assert (factors[-1] > 0.2) if encoded else (factors[-1] < 0.04)
    assert errors[-1] < 0.3
    if encoded:
        assert errors[-1] < 0.8 * errors[0]


def test_nothing_is_believed_but_what_is_usual_until_objects_tell_and_then_the_older_fades() -> None:
    assert believed([]) == believed([UNTOLD, UNTOLD]) == (pytest.approx(USUAL_PX), pytest.approx(25.0))
    told = UNTOLD
    for _ in range(200):
        told = remembered(told, np.array([50.0, 5.0]), 0.1)  # always by 0.1 more than 0.1
    assert believed([told])[0] == pytest.approx(0.2, abs=0.01)
    for _ in range(200):
        told = remembered(told, np.array([50.0, 0.0]), 0.0)
    assert believed([told])[0] == pytest.approx(0.0, abs=0.02)
