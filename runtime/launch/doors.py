"""Which processes of a launch link to one another: those of neighbours, and each to the world's.

Where every process links to all it hears of, as Zenoh's peers do, a launch of 64 has two thousand links, each of which
costs some milliseconds to open. So processes that begin with the run, on one machine and without certificates, each
have a door, which is a socket in the run's folder, and link to the doors that they are told of: of two, one links to
the other's. A process in the place of a lost one has that one's door, where that is free: a child of the lost
one may live on, and hold the lock. Who comes later knows of no doors, and links to all it hears of."""

import fcntl
import os
import re
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hierax.schemas.roster import Roster

MOST_PATH_BYTES = 100  # the kernel takes 107 of a socket's, and Zenoh puts a lock beside it

_PLAIN = re.compile(r"[\w./@+~-]+")  # other characters may mean something in an endpoint of Zenoh's


class Doors(NamedTuple):
    """The door of a process, and those of others that it links to, by their paths."""

    own: str
    others: tuple[str, ...]


NO_DOORS = Doors("", ())


def doors_of(roster: Roster, processes: Mapping[str, Sequence[str]], folder: Path) -> dict[str, Doors]:
    """The doors of all processes, by their names; none, where this folder cannot hold any.

    Args:
        roster: with which the run begins.
        processes: the nodes of each process.
        folder: of the run, which others cannot enter.
    """
    paths = {name: str(folder / f"{number}.door") for number, name in enumerate(sorted(processes))}
    if not _holds_sockets(folder, max(paths.values(), key=len)):
        return {}
    home = {node: name for name, nodes in processes.items() for node in nodes}
    world = home[roster.world]
    others = {name: {world} - {name} for name in processes}
    for pair in roster.pairs:
        one, other = sorted((home[name] for name in pair), key=lambda name: (name != world, name))
        if one != other:
            others[other].add(one)
    return {name: Doors(paths[name], tuple(paths[each] for each in sorted(others[name]))) for name in processes}


def is_free(path: str) -> bool:
    """Whether a session can listen at a door: nobody holds its lock, as Zenoh takes it, and its folder is there."""
    try:
        with open(f"{path}.lock", "w", encoding="ascii") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _holds_sockets(folder: Path, longest: str) -> bool:
    """Whether sockets and their locks can be made there, which is not so on all file systems, and be told to Zenoh by
    their paths."""
    if len(longest.encode()) > MOST_PATH_BYTES or not _PLAIN.fullmatch(longest):
        return False
    probe = folder / "d"
    try:
        with socket.socket(socket.AF_UNIX) as tried:
            tried.bind(str(probe))
            os.unlink(probe)
        free = is_free(str(probe))
        os.unlink(f"{probe}.lock")
    except OSError:
        return False
    return free
