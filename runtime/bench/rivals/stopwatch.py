"""What the rivals' programs share: options, the world's times, and an end with whoever has started them."""

import argparse
import json
import os
import threading
import time

import numpy as np
from numpy.typing import NDArray

WATCH_S = 0.5
PAGE = 4096  # bytes


def options(*roles: str) -> argparse.Namespace:
    """The program's options; the process ends with its parent from now on."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--role", choices=("", *roles), default="")  # this process; none: who starts all
    parser.add_argument("--epochs", type=int, default=1000)
    parser.add_argument("--picture", type=int, default=0)  # bytes
    given = parser.parse_args()
    end_with_parent()
    return given


def end_with_parent() -> None:
    """Have this process end at once when its parent is gone."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def look(picture: NDArray[np.uint8]) -> int:
    """Look at each page of a picture, as who uses it has to."""
    return int(picture[::PAGE].max())


class Stopwatch:
    """Times the world's epochs."""

    def __init__(self, epochs: int) -> None:
        self._epochs = epochs
        self._begun_s = 0.0
        self.times_us: list[float] = []

    def begin(self) -> tuple[int, float]:
        """An epoch begins; its count and level."""
        count = len(self.times_us)
        self._begun_s = time.perf_counter()
        return count, 0.5 * count

    def end(self, count: int) -> bool:
        """An answer came; whether there is another epoch to begin: not after the last, or a repeated answer."""
        if count != len(self.times_us) or self.done:
            return False
        self.times_us.append(1e6 * (time.perf_counter() - self._begun_s))
        return not self.done

    @property
    def done(self) -> bool:
        return len(self.times_us) >= self._epochs

    def tell(self) -> None:
        """Print the times."""
        print(json.dumps(self.times_us), flush=True)
