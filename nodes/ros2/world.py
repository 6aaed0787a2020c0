"""N₀ over topics of ROS 2: what joints, cameras and whatever else publish, near in time."""

import math
import weakref
from collections.abc import Mapping
from typing import Any

from hierax.nodes.ros2.carrier import address_of
from hierax.nodes.ros2.live import LiveTopics
from hierax.nodes.sources.shots import Seen
from hierax.runtime import World


class TopicsBelief(Seen):
    """What the world that shows topics is."""

    heard: Mapping[str, Any] | None  # the newest messages by the topics' names here; None: none came for this epoch


class TopicsWorld(World):
    """Shows the newest messages of topics that belong together, see `hierax.nodes.ros2.live.plain` for how. They are
    part of the belief, as a camera's frame is, so a recording repeats them.

    Args:
        topics: what they are called here, and their names: ``{joints: "ros:/joint_states?qos=reliable"}``, all of one
            carrier. By the first the others go, within `within_s` seconds, and of it messages are counted that were
            passed over.
        source_timeout: seconds without any until it stalls; reopen: as for `hierax.nodes.sources.camera.CameraWorld`.
    Raises DataError: a name is no topic's. ValueError: an option is out of range."""

    def __init__(
        self, topics: dict[str, str], within_s: float = 0.02, source_timeout: float = 5.0, reopen: bool = False
    ) -> None:
        if not topics or not 0.0 <= within_s < math.inf or not 0.0 < source_timeout < math.inf:
            told = f"topics are {topics}, within_s is {within_s}, source_timeout is {source_timeout}"
            raise ValueError(f"{told}; expected some, not less than 0, and more than 0")
        addresses = {name: address_of(each, ("qos",)) for name, each in topics.items()}
        if len({(each.carrier, each.router) for each in addresses.values()}) > 1:
            raise ValueError(f"topics are {topics}; expected all of one carrier")
        self._source = LiveTopics(addresses, within_s, source_timeout, reopen, set())
        weakref.finalize(self, self._source.close)

    def initial_belief(self) -> TopicsBelief:
        """The first messages are yet to come."""
        return self._next(
            {
                "index": 0,
                "frame": -1,
                "size": None,
                "time_s": 0.0,
                "wall_s": None,
                "passed_over": 0,
                "stalls": 0,
                "reopened": 0,
                "ended": False,
                "heard": None,
            }
        )

    def predict(self, context: tuple[()], actions: tuple[()], belief: TopicsBelief) -> TopicsBelief:
        """Time passes: the newest messages."""
        return self._next({**belief, "index": belief["index"] + 1})

    def time_s(self, belief: TopicsBelief, epoch: int) -> float:
        """The stamp of the first topic's message."""
        return belief["time_s"]

    def metrics(self, belief: TopicsBelief) -> Mapping[str, float]:
        """How many messages were passed over, epochs had none, and how often all was opened again."""
        return {"passed_over": belief["passed_over"], "stalls": belief["stalls"], "reopened": belief["reopened"]}

    def _next(self, belief: TopicsBelief) -> TopicsBelief:
        shot = self._source.shot(belief)
        return {
            **belief,
            "frame": shot.frame,
            "heard": shot.heard,
            "time_s": shot.time_s,
            "wall_s": shot.wall_s,
            "passed_over": belief["passed_over"] + shot.passed_over,
            "stalls": belief["stalls"] + (shot.heard is None),
            "reopened": shot.reopened,
        }


def topics_heard(belief: TopicsBelief) -> tuple[Mapping[str, Any], ...]:
    """φ of a `TopicsWorld`: one element, the messages by the topics' names; none where none came."""
    return () if belief["heard"] is None else (belief["heard"],)
