"""The chain in ezmsg: units in processes of their own; arrays go through its shared memory, and are read in place."""

from collections.abc import AsyncGenerator
from typing import Any

import ezmsg.core as ez
import numpy as np

from hierax.runtime.bench.rivals.stopwatch import Stopwatch, end_with_parent, look, options

BUFFER_BYTES = 4 << 20  # of each of its publisher's buffers: room for a picture

Sent = AsyncGenerator[tuple[ez.OutputStream, Any], None]


class Settings(ez.Settings):
    """Of the chain."""

    epochs: int
    picture: int  # bytes


class Unit(ez.Unit):
    """One of the processes."""

    SETTINGS = Settings

    async def initialize(self) -> None:
        end_with_parent()


class World(Unit):
    """Sends up, and times what comes down."""

    UP = ez.OutputStream(tuple)
    DOWN = ez.InputStream(tuple)

    async def initialize(self) -> None:
        await super().initialize()
        self.stopwatch = Stopwatch(self.SETTINGS.epochs)

    @ez.publisher(UP)
    async def begin(self) -> Sent:
        yield self.UP, self.stopwatch.begin()

    @ez.subscriber(DOWN)
    @ez.publisher(UP)
    async def on_down(self, message: tuple[int, float]) -> Sent:
        if self.stopwatch.end(message[0]):
            yield self.UP, self.stopwatch.begin()
        elif self.stopwatch.done:
            self.stopwatch.tell()
            raise ez.NormalTermination


class Arm(Unit):
    """Passes on."""

    UP_IN, UP_OUT = ez.InputStream(tuple), ez.OutputStream(tuple)
    DOWN_IN, DOWN_OUT = ez.InputStream(tuple), ez.OutputStream(tuple)

    @ez.subscriber(UP_IN)
    @ez.publisher(UP_OUT)
    async def on_up(self, message: tuple[int, float]) -> Sent:
        yield self.UP_OUT, message

    @ez.subscriber(DOWN_IN, zero_copy=True)
    @ez.publisher(DOWN_OUT)
    async def on_down(self, message: Any) -> Sent:
        if len(message) > 2:
            look(message[2])
        yield self.DOWN_OUT, message[:2]


class Spatial(Unit):
    """Answers."""

    UP = ez.InputStream(tuple)
    DOWN = ez.OutputStream(tuple, buf_size=BUFFER_BYTES)

    async def initialize(self) -> None:
        await super().initialize()
        self.picture = np.ones(self.SETTINGS.picture, np.uint8)

    @ez.subscriber(UP)
    @ez.publisher(DOWN)
    async def on_up(self, message: tuple[int, float]) -> Sent:
        yield self.DOWN, (*message, self.picture) if self.SETTINGS.picture else message


def main() -> None:
    """Start the processes."""
    given = options()
    settings = Settings(given.epochs, given.picture)
    units = {"world": World(settings), "arm": Arm(settings), "spatial": Spatial(settings)}
    world, arm, spatial = units.values()
    ez.run(
        components=units,
        connections=(
            (world.UP, arm.UP_IN),
            (arm.UP_OUT, spatial.UP),
            (spatial.DOWN, arm.DOWN_IN),
            (arm.DOWN_OUT, world.DOWN),
        ),
        process_components=tuple(units.values()),
    )


if __name__ == "__main__":
    main()
