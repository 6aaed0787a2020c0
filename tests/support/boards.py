"""Pictures of calibration boards, as a camera of known intrinsics and distortion would take them."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from hierax.nodes.sources.boards import Board
from hierax.nodes.sources.calibration import Lens
from hierax.nodes.sources.images import Array
from hierax.nodes.sources.shots import Floats

SIZE = (640, 480)
PINHOLE = Lens(
    "drawn", SIZE, np.array([612.0, 610.5, 322.5, 238.0]), np.array([-0.28, 0.11, 8e-4, -6e-4, -0.02]), False
)
FISHEYE = Lens("drawn", SIZE, np.array([320.0, 320.0, 322.5, 238.0]), np.array([0.05, -0.01, 0.004, -0.002]), True)
SQUARE_M, MARKER_M = 0.025, 0.018
DICTIONARY = cv2.aruco.DICT_4X4_50
CHESSBOARD = Board(9, 6, SQUARE_M)
CHARUCO = Board(9, 6, SQUARE_M, MARKER_M, cv2.aruco.getPredefinedDictionary(DICTIONARY))
_CELL_PX, _SAMPLES, _BLUR_PX, _NOISE = 50, 2, 0.6, 2.0
_DARK, _BRIGHT = 25.0, 215.0


class Printed(NamedTuple):
    """A board on paper: its picture, and a pixel's side in metres."""

    picture: Array
    pixel_m: float


def printed(board: Board) -> Printed:
    """The board with white around it."""
    if board.marker_m is None:
        squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        pattern = np.pad(np.kron(squares, np.ones((_CELL_PX, _CELL_PX))), _CELL_PX, constant_values=1.0)
    else:
        drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, board.dictionary)
        size = ((board.columns + 1) * _CELL_PX, (board.rows + 1) * _CELL_PX)
        pattern = drawn.generateImage(size, marginSize=_CELL_PX // 2) / 255.0
    return Printed((_DARK + (_BRIGHT - _DARK) * pattern).astype(np.float32), board.square_m / _CELL_PX)


def pictures(board: Board, lens: Lens, count: int, seed: int) -> list[Array]:
    """So many pictures of a board, tilted, near and far, all over the picture."""
    rng, paper, rays = np.random.default_rng(seed), printed(board), _rays(lens)
    middle = np.array([*(0.5 * paper.pixel_m * np.array(paper.picture.shape[::-1])), 0.0])
    wide = 1.6 if lens.fisheye else 1.0
    found = []
    for _ in range(count):
        turn = cv2.Rodrigues(np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)))[0]
        depth = rng.uniform(0.28, 0.5)
        at = depth * np.array([wide * rng.uniform(-0.25, 0.25), wide * rng.uniform(-0.18, 0.18), 1.0])
        found.append(_seen(paper, rays, turn, at - turn @ middle, rng))
    return found


def _rays(lens: Lens) -> Floats:
    """Directions of all samples of the picture, by the inverse of OpenCV's distortion."""
    across, down = ((np.arange(_SAMPLES * side) + 0.5) / _SAMPLES - 0.5 for side in lens.size)
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 1, 2)
    straight: Any = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    flat = straight(pixels, lens.matrix, lens.coefficients).reshape(-1, 2)
    return np.column_stack([flat, np.ones(len(flat))])


def _seen(paper: Printed, rays: Floats, turn: Floats, shift: Floats, rng: np.random.Generator) -> Array:
    eye, along = -turn.T @ shift, rays @ turn
    points = eye[:2] - (eye[2] / along[:, 2])[:, None] * along[:, :2]
    shape = (_SAMPLES * SIZE[1], _SAMPLES * SIZE[0])
    places = (points / paper.pixel_m - 0.5).astype(np.float32)
    fine = cv2.remap(paper.picture, *(each.reshape(shape) for each in places.T), cv2.INTER_LINEAR, borderValue=190.0)
    soft = cv2.GaussianBlur(cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA), (0, 0), _BLUR_PX)
    return np.clip(np.rint(soft + rng.normal(0.0, _NOISE, soft.shape)), 0, 255).astype(np.uint8)
