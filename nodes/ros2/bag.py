"""Frames of a rosbag2: all pictures of one of its topics, and what its CameraInfo says of the lens."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hierax.nodes.ros2.messages import (
    CAMERA_INFO,
    COMPRESSED,
    IMAGE,
    NS,
    beside,
    decoded,
    header_of,
    image_of,
    reading,
    require,
    told_lens,
)
from hierax.nodes.sources.calibration import Lens
from hierax.nodes.sources.files import DataError
from hierax.nodes.sources.shots import Seen, Shot, Source, ending

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_KINDS = (IMAGE, COMPRESSED)
_EXPECTED = f"{IMAGE} or {COMPRESSED}"
_WHOLE = "rosbag2, MCAP or SQLite"


class BagFrames(Source):
    """The pictures of a rosbag2's topic, in the order in which they were recorded, at their headers' times.

    Args:
        path: the bag's folder, or a single file of it, .mcap or .db3.
        topic: which, where there are several with pictures.
        calibrated: whether the lens is known already, and no CameraInfo is read.
    Raises DataError: it is damaged, has no such topic, or no picture there."""

    def __init__(self, path: Path, topic: str | None = None, calibrated: bool = False) -> None:
        require("rosbags.rosbag2", path)
        from rosbags.rosbag2 import Reader

        self._path = path
        with reading(str(path), _WHOLE):
            self._reader = Reader(path)
            self._reader.open()
        try:
            self._topic = _choose(path, self._reader.connections, topic)
            self.name = f"{path}: {self._topic}"
            self._images = [each for each in self._reader.connections if each.topic == self._topic]
            with reading(self.name, _WHOLE):
                self._count = sum(each.msgcount for each in self._images)
            if not self._count:
                raise DataError(f"{self.name}: has no messages; expected pictures")
            self.lens = None if calibrated else self._told_lens()
        except BaseException:
            self.close()
            raise
        self._next, self._found = 0, self._read(self._images)

    def shot(self, belief: Seen) -> Shot:
        index = belief["index"]
        if index < self._next:
            self._next, self._found = 0, self._read(self._images)
        data = b""
        while self._next <= index:
            found = next(self._found, None)
            if found is None:
                if self._next < self._count:
                    raise DataError(f"{self.name}: ends after {self._next} pictures; expected {self._count}")
                return ending(belief)
            kind, data = found
            self._next += 1
        where = f"{self.name}, picture {index + 1}"
        message = _decoded(where, kind, data)
        header = header_of(where, message)
        return Shot(index, image_of(where, message), header["stamp_ns"] / NS, header=header)

    def close(self) -> None:
        self._reader.close()

    def _read(self, connections: "Sequence[Connection]") -> Iterator[tuple[str, bytes]]:
        """Types and contents of the messages."""
        with reading(self.name, _WHOLE):
            for connection, _, data in self._reader.messages(connections):
                yield connection.msgtype, data

    def _told_lens(self) -> Lens | None:
        """As the first CameraInfo beside the topic has it, or of the bag where it has just one; None: there is none,
        or it says that nobody knows."""
        expected, straight = beside(self._topic, self._images[0].msgtype == COMPRESSED)
        infos = {each.topic for each in self._reader.connections if each.msgtype == CAMERA_INFO and each.msgcount}
        chosen = infos & {expected} or (infos if len(infos) == 1 else set())
        found = next(self._read([each for each in self._reader.connections if each.topic in chosen]), None)
        if not chosen or found is None:
            return None
        where = f"{self._path}: {min(chosen)}"
        return told_lens(where, _decoded(where, *found), straight)


def _choose(path: Path, connections: "Sequence[Connection]", topic: str | None) -> str:
    """The topic with pictures: the given one, or the only one. Raises DataError: it is another's, or there are others,
    which are told."""
    kinds: dict[str, str] = {each.topic: each.msgtype for each in connections}
    shown = sorted(name for name, kind in kinds.items() if kind in _KINDS)
    listed = ", ".join(shown)
    if topic is None:
        if len(shown) == 1:
            return shown[0]
        if shown:
            raise DataError(
                f"{path}: has pictures on {listed}; expected one of them as topic (camera_topic of tracking)"
            )
        others = ", ".join(f"{name} ({kind})" for name, kind in sorted(kinds.items())) or "nothing"
        raise DataError(f"{path}: expected a topic of {_EXPECTED}, found {others:.400}")
    if topic not in kinds:
        raise DataError(f"{path}: has no topic {topic}; expected one with pictures: {listed or 'there is none'}")
    if topic not in shown:
        raise DataError(f"{path}: {topic} is of {kinds[topic]}; expected {_EXPECTED}: {listed or 'there is none'}")
    return topic


def _decoded(where: str, kind: str, data: bytes) -> Any:
    with reading(where, _WHOLE):
        return decoded(data, kind)
