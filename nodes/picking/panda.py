"""The Franka Panda: where its gripper and its hand camera are for given joints, and joints for a wanted gripper pose.

The gripper's frame has its origin between the finger pads; z points along the fingers (the direction of approach), y is
the direction in which they close. Lengths are those of the maker's table of Denavit-Hartenberg parameters (Craig's
convention), as in pybullet_data's model. The arm stands in the origin of the world, on the table z = 0."""

from math import sqrt

import numpy as np

from hierax.nodes.tracking.math.geometry import Array, Floats, exp_so3, invert, log_so3, make_pose

JOINTS = 7

_OFFSETS_M = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088)
_HEIGHTS_M = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0)
_TWISTS_RAD = tuple(turns * np.pi / 2 for turns in (0, -1, 1, 1, -1, 1, 1))
_FLANGE_M = 0.107
_HAND_TURN_RAD = -np.pi / 4

HAND_TO_GRIPPER_M = 0.1034  # from the hand's frame, on the flange, to between the finger pads
_TWISTS = np.stack((np.cos(_TWISTS_RAD), np.sin(_TWISTS_RAD)), axis=1)  # (7, 2)
_FLANGE_TO_GRIPPER = make_pose(
    exp_so3(np.array([0.0, 0.0, _HAND_TURN_RAD])), np.array([0.0, 0.0, _FLANGE_M + HAND_TO_GRIPPER_M])
)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]  # of a cross product's axes
LOWEST_RAD = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
HIGHEST_RAD = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
TORQUES_NM = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
WIDEST_M = 0.08

# The posture that the arm keeps to as far as the gripper's pose leaves it free.
REST_RAD = np.array([0.0, -0.55, 0.0, -2.45, 0.0, 2.1, 0.785])

_HOME_TILT_RAD = np.radians(15.0)
_HOME_M = np.array([0.30, 0.0, 0.38])

FOCAL_LENGTH = 0.8  # of the camera in the hand, in widths of its picture
_CAMERA_M = np.array([-0.083, 0.0, -0.065])
_CAMERA_AXES = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_CAMERA_TILT_RAD = np.radians(20.0)

_DAMPED = 1e-5 * np.eye(6)
_POSTURE = 0.1
_NEAR = 1e-7
_SUM_MAX = 0.3


def gripper_at(joints: Floats) -> Floats:
    """world_from_gripper (4, 4) for joint angles (7,), radians."""
    return _chain(joints)[1]


def joints_for(gripper: Floats, start: Floats, iterations: int = 60, near: float = 0.0) -> tuple[Floats, float]:
    """Joint angles (7,), within the joints' limits, that bring the gripper to a pose, from a start by at most so many
    steps of damped least squares; and how far off it then is: metres or radians, whichever is more. Where it is as near
    as that, it is left at that, even if the arm has not come to its posture yet."""
    joints = np.array(start, dtype=np.float64)
    for _ in range(iterations):
        error, jacobian = _error(gripper, joints)
        off = np.abs(error).max()
        if off < near:
            break
        wished = _POSTURE * (REST_RAD - joints)
        step = wished + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPED, error - jacobian @ wished)
        if off < _NEAR and np.abs(step).max() < _NEAR:
            break
        step *= min(1.0, _SUM_MAX / max(sqrt(step @ step), 1e-12))
        joints = np.minimum(np.maximum(joints + step, LOWEST_RAD), HIGHEST_RAD)
    return joints, float(np.abs(_error(gripper, joints)[0]).max())


def camera_of(gripper: Floats) -> Floats:
    """world_from_camera of world_from_gripper."""
    return np.asarray(gripper @ GRIPPER_FROM_CAMERA)


def gripper_down(position_m: Array, yaw_rad: float = 0.0, tilt_rad: float = 0.0) -> Floats:
    """world_from_gripper for a gripper that points down, turned about the vertical and leaning forward."""
    turn = exp_so3(np.array([0.0, 0.0, yaw_rad])) @ exp_so3(np.array([0.0, -tilt_rad, 0.0]))
    return make_pose(turn @ np.diag([1.0, -1.0, -1.0]), np.asarray(position_m, dtype=np.float64))


def _chain(joints: Floats) -> tuple[Floats, Floats]:
    """The frames (7, 4, 4) of the joints, each turning about its z, and the gripper's, all in the world."""
    cosines, sines = np.cos(joints), np.sin(joints)
    frames = _LINKS.copy()
    frames[:, 0, 0], frames[:, 0, 1] = cosines, -sines
    frames[:, 1:3, 0], frames[:, 1:3, 1] = sines[:, None] * _TWISTS, cosines[:, None] * _TWISTS
    for index in range(1, JOINTS):
        frames[index] = frames[index - 1] @ frames[index]
    return frames, frames[-1] @ _FLANGE_TO_GRIPPER


def _error(gripper: Floats, joints: Floats) -> tuple[Floats, Floats]:
    """What the gripper lacks to its pose (6,; metres, radians, world's axes), and how the joints change that (6, 7)."""
    frames, reached = _chain(joints)
    error = np.empty(6)
    error[:3] = gripper[:3, 3] - reached[:3, 3]
    error[3:] = log_so3(gripper[:3, :3] @ reached[:3, :3].T)
    jacobian = np.empty((6, JOINTS))
    axes = jacobian[3:] = frames[:, :3, 2].T
    arms = reached[:3, 3, None] - frames[:, :3, 3].T
    jacobian[:3] = axes[_NEXT] * arms[_LAST] - axes[_LAST] * arms[_NEXT]  # np.cross takes ten times as long
    return error, jacobian


def _links() -> Floats:
    """The joints' frames, each in the one before it, but for what turns with the joints (7, 4, 4)."""
    links = np.tile(np.eye(4), (JOINTS, 1, 1))
    links[:, 0, 3] = _OFFSETS_M
    links[:, 1, 2], links[:, 2, 2] = -_TWISTS[:, 1], _TWISTS[:, 0]
    links[:, 1, 3], links[:, 2, 3] = -_TWISTS[:, 1] * _HEIGHTS_M, _TWISTS[:, 0] * _HEIGHTS_M
    return links


_LINKS = _links()

# Behind the hand, leaning over to the fingers, whose tips are just out of its view.
GRIPPER_FROM_CAMERA = make_pose(exp_so3(np.array([0.0, _CAMERA_TILT_RAD, 0.0])) @ _CAMERA_AXES, _CAMERA_M)
HOME_GRIPPER = gripper_down(_HOME_M, tilt_rad=_HOME_TILT_RAD)  # world_from_gripper where the camera overlooks the table
HOME_RAD = joints_for(HOME_GRIPPER, REST_RAD, 300)[0]
CAMERA_FROM_GRIPPER = invert(GRIPPER_FROM_CAMERA)
