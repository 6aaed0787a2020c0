"""What is asked of the gripper, handed down from node to node as task parameters.

A command is {"gripper": world_from_gripper (4, 4), "width": metres between the finger pads, "speed": m/s at most}. On
the way down each node's policy is chosen by the command that came from above: the policy's name holds the command, and
the policy's one action is that command again, its turn rounded as a unit quaternion is."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from hierax.nodes.tracking.math.geometry import Array, make_pose, quaternion_of, rotation_of
from hierax.runtime import Elements, Node, Value
from hierax.runtime.core.node import Policy, do_nothing

REST = "default"
MOVE = "move"

_NUMBERS = 9

Command = dict[str, Any]


def command(gripper: Array, width_m: float, speed_m_s: float) -> Command:
    """A command: world_from_gripper, metres between the finger pads (less than what is between them squeezes it), and
    how fast the gripper may go there, m/s."""
    return {"gripper": gripper, "width": float(width_m), "speed": float(speed_m_s)}


def name_of(tasks: Elements) -> str:
    """The name of the policy that carries out a task: λ of all nodes between the grasp node and the arm."""
    if not tasks:
        return REST
    wanted = tasks[0]
    pose = wanted["gripper"]
    numbers = (*pose[:3, 3], *quaternion_of(pose[:3, :3]), wanted["width"], wanted["speed"])
    return " ".join((MOVE, *(repr(float(number)) for number in numbers)))


class Named(Mapping[str, Policy]):
    """Π: ``default`` and, for each name that can be read, the policy that it stands for; read: gives it, or raises
    ValueError."""

    def __init__(self, read: Callable[[str], Policy]) -> None:
        self._read = read

    def __getitem__(self, name: str) -> Policy:
        try:
            return self._read(name)
        except ValueError:
            raise KeyError(name) from None

    def __iter__(self) -> Iterator[str]:
        return iter((REST,))

    def __len__(self) -> int:
        return 1


def command_of(name: str) -> Command:
    """The command that a policy's name holds. Raises ValueError: it holds none."""
    order, *words = name.split(" ")
    if order != MOVE or len(words) != _NUMBERS:
        raise ValueError(f"no policy has the name {name!r}")
    numbers = np.array([float(word) for word in words])
    return command(make_pose(rotation_of(numbers[3:7]), numbers[:3]), numbers[7], numbers[8])


class CommandedNode(Node):
    """A node that is told what the gripper has to do, and by default hands it on."""

    def select_policy(self, tasks: Elements) -> str:
        """λ: to carry out the command; of none, to do nothing."""
        return name_of(tasks)

    def policies(self) -> Mapping[str, Policy]:
        """Π: for every command, its execution; ``default`` does nothing."""
        return Named(self._policy)

    def _policy(self, name: str) -> Policy:
        if name == REST:
            return do_nothing
        wanted = command_of(name)
        return lambda belief: (self.carried_out(wanted, belief),)

    def carried_out(self, wanted: Command, belief: Value) -> Command:
        """The action by which a command is carried out."""
        return wanted


def handed_down(actions: Elements) -> Elements:
    """ψ of all edges: the commands are the task of the node below."""
    return actions
