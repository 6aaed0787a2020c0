"""Seeing a run in this process, or a launch, which waits for nobody: what cannot be shown in time is left out."""

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil
from threading import Event

from hierax.runtime.core.probe import Step
from hierax.runtime.deployment import Deployment
from hierax.runtime.engine.effects import Completed
from hierax.runtime.execution import single
from hierax.runtime.execution.report import Report
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.loading.allowance import Allowance
from hierax.runtime.transport.launch_client import LaunchClient, LaunchStatus
from hierax.runtime.transport.port import TransportError
from hierax.runtime.viewing.presenter import ViewPresenter
from hierax.runtime.viewing.views import ShownNodes
from hierax.runtime.watch.watcher import Watcher, read_step
from hierax.schemas.errors import SchemaError
from hierax.schemas.keys import STEP
from hierax.schemas.roster import Roster

MOST_EPOCHS_PER_S = 30.0  # how many epochs are shown; a quicker launch is shown every second, third, … epoch
ASK_EVERY_S = 1.0  # nodes tell their steps for some seconds after they were asked
STEPS_WAITING = 512  # how many steps wait to be shown; of more than that, the oldest are forgotten

_log = logging.getLogger("hierax")


def show_launch(
    client: LaunchClient, presenter: ViewPresenter, allowance: Allowance, over: Callable[[], bool] = lambda: False
) -> int:
    """Show a launch until it ends, or `over`, which is asked often, says that it is enough; how many steps were shown.
    Raises `TransportError` if it does not answer from the beginning, and `HieraxError` if a node cannot be loaded here,
    or what it shows cannot be shown."""
    status = client.status()
    inbox = _Inbox()
    client.listen(client.keys().seen(STEP, "*", "*"), inbox.put)
    stage = _Stage(presenter, allowance)
    epoch, asked_s = status.epoch, time.monotonic()
    stage.set_roster(_ask(client, status, every=1))
    while not over():
        if time.monotonic() - asked_s >= ASK_EVERY_S:
            try:
                status = client.status()
                every = shown_every(status.epoch - epoch, time.monotonic() - asked_s)
                epoch, asked_s = status.epoch, time.monotonic()
                stage.set_roster(_ask(client, status, every))
            except TransportError:
                break  # it has ended
        stage.show(inbox.take(ASK_EVERY_S / 4))
    stage.show(inbox.take(0.0))
    presenter.close()
    return stage.shown


def shown_every(epochs: int, took_s: float) -> int:
    """How many epochs there are to each that can be shown of a launch that took so long for some."""
    return max(1, ceil(epochs / max(took_s, 1e-3) / MOST_EPOCHS_PER_S))


def _ask(client: LaunchClient, status: LaunchStatus, every: int) -> Roster | None:
    """Have all nodes tell their steps for a while; the roster, if the world answers."""
    answers = client.ask_nodes(status, {"look": "steps", "every": every}, status.nodes).values()
    rosters = (answer["roster"] for answer in answers if answer.get("roster") is not None)
    return next(map(Roster.read, rosters), None)


class _Inbox:
    """Steps as they come, in a thread of the transport's, until they are shown."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=STEPS_WAITING)
        self._came = Event()

    def put(self, key: str, data: bytes) -> None:
        self._waiting.append((key.split("/")[-2], data))  # who says it: anything may stand behind that
        self._came.set()

    def take(self, timeout_s: float) -> list[tuple[str, bytes]]:
        """Names and steps since the last time; waits a while for one where there is none."""
        self._came.wait(timeout_s)
        self._came.clear()
        return [self._waiting.popleft() for _ in range(len(self._waiting))]


class _Stage:
    """Shows steps under the roster that is in force."""

    def __init__(self, presenter: ViewPresenter, allowance: Allowance) -> None:
        self._presenter = presenter
        self._nodes = ShownNodes(allowance)
        self._roster: Roster | None = None
        self._last: tuple[int, int] | None = None
        self._has_warned = False
        self.shown = 0

    def set_roster(self, roster: Roster | None) -> None:
        """The roster as the world tells it; None: it did not."""
        if roster is not None:
            self._roster = roster
            self._presenter.set_roster(roster)

    def show(self, steps: list[tuple[str, bytes]]) -> None:
        """Show what nodes did."""
        for name, data in steps:
            if self._roster is None or name not in self._roster.nodes:
                continue  # of a roster that this one has not been told of yet
            told = self._told(name, data)
            if told is None:
                continue
            done_ns, step = told
            if name == self._roster.world:
                if self._last is not None and step.epoch > self._last[0]:  # where some are left out, their mean
                    took_s = (done_ns - self._last[1]) / 1e9 / (step.epoch - self._last[0])
                    self._presenter.epoch_took(step.epoch, step.time_s, took_s)
                self._last = (step.epoch, done_ns)
            self._presenter.step(name, self._nodes.node(self._roster, name), step)
            self.shown += 1

    def _told(self, name: str, data: bytes) -> tuple[int, Step] | None:
        """When a node did a step, and that; None: what came on its key is none, which is said once."""
        try:
            return read_step(data)
        except SchemaError as error:
            if not self._has_warned:
                _log.warning("%s: not shown, as all else that is no step: %s", name, error)
            self._has_warned = True
            return None


def run_seen(deployment: Deployment, presenter: ViewPresenter, *, epochs: int | None, seed: int) -> Report:
    """Run a deployment in this process and show it; `HieraxError` as `single.run` has it, or if it cannot be shown."""
    presenter.set_roster(deployment.roster)
    clock = _Clock()

    def watch(name: str, runner: NodeRunner) -> None:
        runner.watch(_Seen(name, runner, presenter, clock))

    try:
        report = single.run(deployment, epochs=epochs, seed=seed, watch=watch)
    except BaseException:
        presenter.close(is_whole=False)
        raise
    presenter.close()
    return report


class _Clock:
    """Time that stands still while things are drawn, as they are in the run's only thread."""

    def __init__(self) -> None:
        self._stood_s = 0.0
        self._since_s = 0.0

    def read_s(self) -> float:
        return time.perf_counter() - self._stood_s

    def __enter__(self) -> None:
        self._since_s = time.perf_counter()

    def __exit__(self, *error: object) -> None:
        self._stood_s += time.perf_counter() - self._since_s


@dataclass(eq=False)
class _Seen(Watcher):
    """Shows what one node does."""

    name: str
    runner: NodeRunner
    presenter: ViewPresenter
    clock: _Clock

    def __post_init__(self) -> None:
        self._begun_s = self.clock.read_s()
        self._took_s: tuple[int, float] | None = None

    def committed(self, epoch: int, digest: bytes) -> None:
        now_s = self.clock.read_s()
        self._took_s = (epoch, now_s - self._begun_s)
        self._begun_s = now_s

    def completed(self, completed: Completed) -> None:
        step = completed.step
        with self.clock:
            if self._took_s is not None and self._took_s[0] == step.epoch:
                self.presenter.epoch_took(step.epoch, step.time_s, self._took_s[1])
            self.presenter.step(self.name, self.runner.engine.node.node, step)
