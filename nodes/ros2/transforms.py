"""Where frames are beside one another, by `/tf` and `/tf_static`, in time."""

from bisect import bisect_left
from collections import deque
from typing import Any

import numpy as np

from hierax.nodes.ros2.messages import NS
from hierax.nodes.sources.shots import Floats
from hierax.nodes.tracking.math.geometry import exp_so3, invert, log_so3, make_pose, rotation_of

_KEPT = 2000  # transforms of a frame: 10 s at 200 Hz
_DEEPEST = 100  # frames on top of one another


class Transforms:
    """What was heard of each frame: its parent, and parent_from_frame at times."""

    def __init__(self) -> None:
        self._static: dict[str, tuple[str, Floats]] = {}
        self._moving: dict[str, tuple[str, deque[tuple[int, Floats]]]] = {}

    def add(self, message: Any, static: bool) -> None:
        """A `TFMessage` came. What is no transform is passed over."""
        for each in message.transforms:
            parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
            place, turn = each.transform.translation, each.transform.rotation
            numbers = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
            if not np.isfinite(numbers).all() or not np.square(numbers[3:]).any():  # as what is tiny has no direction
                continue
            pose = make_pose(rotation_of(numbers[3:]), numbers[:3])
            if static:
                self._static[child] = parent, pose
                continue
            known = self._moving.get(child)
            if known is None or known[0] != parent:
                known = self._moving[child] = parent, deque(maxlen=_KEPT)
            stamp_ns = each.header.stamp.sec * NS + each.header.stamp.nanosec
            if known[1] and stamp_ns < known[1][-1][0]:  # time began anew, as when a bag is played again
                known[1].clear()
            known[1].append((stamp_ns, pose))

    def find(self, frame: str, child: str, stamp_ns: int) -> Floats | None:
        """frame_from_child at a time; None: it is not known, or not yet. Between two times that were heard it is on
        the way from one to the other; nothing is known after the last."""
        ours, theirs = self._up(child.lstrip("/"), stamp_ns), self._up(frame.lstrip("/"), stamp_ns)
        common = next((each for each in ours if each in theirs), None)
        return None if common is None else invert(theirs[common]) @ ours[common]

    def _up(self, frame: str, stamp_ns: int) -> dict[str, Floats]:
        """ancestor_from_frame of a frame and all those above it."""
        pose, found = np.eye(4), {frame: np.eye(4)}
        for _ in range(_DEEPEST):
            above = self._above(frame, stamp_ns)
            if above is None or above[0] in found:
                break
            frame, pose = above[0], above[1] @ pose
            found[frame] = pose
        return found

    def _above(self, frame: str, stamp_ns: int) -> tuple[str, Floats] | None:
        if frame in self._static:
            return self._static[frame]
        if frame not in self._moving:
            return None
        parent, heard = self._moving[frame]
        at = bisect_left(heard, stamp_ns, key=lambda each: each[0])
        if at == len(heard) or (at == 0 and heard[0][0] != stamp_ns):
            return None
        after_ns, after = heard[at]
        if after_ns == stamp_ns:
            return parent, after
        before_ns, before = heard[at - 1]
        part = (stamp_ns - before_ns) / (after_ns - before_ns)
        turn = before[:3, :3] @ exp_so3(part * log_so3(before[:3, :3].T @ after[:3, :3]))
        return parent, make_pose(turn, (1.0 - part) * before[:3, 3] + part * after[:3, 3])
