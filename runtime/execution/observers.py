"""Those who see what a node does: its state log, its probes, and watchers that come and go."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack

from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import FAILURES, ProbeError
from hierax.runtime.core.probe import Probe
from hierax.runtime.engine.effects import Completed
from hierax.runtime.engine.engine import Engine
from hierax.runtime.execution.output_folder import EpochLog
from hierax.runtime.watch.watcher import Watcher


class Observers:
    """What a node's process has from its first instant on, before the node has an engine.

    What must lack no epoch, wherever the process dies, is written before the checkpoint and what is sent: the state
    log, and what prompt probes see. Other probes and watchers are served when nobody waits for this node."""

    def __init__(self, name: str, probes: Sequence[Probe] = (), states: EpochLog | None = None) -> None:
        self.watchers: tuple[Watcher, ...] = ()  # who sees what the node does
        self.engine: Engine | None = None  # of the node; None: there is none yet
        self.last: Completed | None = None  # the last epoch that it has completed; None: none yet
        self.before: Value = None  # the belief that this epoch began in, where the one before was completed here, too
        self._name = name  # of the node
        self._probes = probes  # of the node, open
        # Where of every completed epoch [epoch, attempt, state, digest] is written; None: nowhere. The state is the
        # encoding of (belief, policy, actions) that the digest is taken over, so that anyone can take it again.
        self._states = states

    def follow(self, engine: Engine) -> None:
        self.engine = engine
        self._ask_for_calls()  # one that comes at this moment, in another thread, finds the engine

    def watch(self, watcher: Watcher) -> None:
        """Have a watcher see what the node does from now on; always called by the same thread."""
        self._set_watchers((*self.watchers, watcher))

    def unwatch(self, watcher: Watcher) -> None:
        """Have it see nothing more; by the thread that calls `watch`."""
        self._set_watchers(tuple(each for each in self.watchers if each is not watcher))

    def _set_watchers(self, watchers: tuple[Watcher, ...]) -> None:
        self.watchers = watchers  # replaced, never changed in place: the node's thread may be going through them
        self._ask_for_calls()

    def _ask_for_calls(self) -> None:
        if self.engine is not None:
            self.engine.events = any(type(each).called is not Watcher.called for each in self.watchers)

    def predicted(self, completed: Completed) -> None:
        """The node is done with an epoch, and nothing of it has gone out yet. Raises `ProbeError` if a probe raised."""
        if self._states is not None:
            step = completed.step
            self._states.write(step.epoch, step.attempt, completed.state, completed.digest)
            self._states.flush()
        for probe in self._probes:
            if probe.prompt:
                self._show(probe, completed)
        for watcher in self.watchers:
            watcher.predicted(completed)

    def completed(self, completed: Iterable[Completed]) -> None:
        """The node is done with these epochs, and nobody waits for it. Raises `ProbeError` if a probe raised."""
        for each in completed:
            follows = self.last is not None and self.last.step.epoch == each.step.epoch - 1
            self.before = self.last.step.belief if self.last is not None and follows else None
            self.last = each
            for watcher in self.watchers:
                watcher.completed(each)
            for probe in self._probes:
                if not probe.prompt:
                    self._show(probe, each)

    def close(self) -> None:
        """Close the state log, all watchers and all probes. Raises `ProbeError` if a probe raised."""
        if self._states is not None:
            self._states.close()
        for watcher in self.watchers:
            watcher.close()
        self._set_watchers(())
        with ExitStack() as closing:  # one that raises keeps none from being closed
            for probe in reversed(self._probes):
                closing.callback(self._call, probe, "close", probe.close)

    def _show(self, probe: Probe, completed: Completed) -> None:
        step = completed.step
        self._call(probe, f"record in epoch {step.epoch}", probe.record, step)

    def _call(self, probe: Probe, operation: str, method: Callable[..., None], *arguments: object) -> None:
        try:
            method(*arguments)
        except FAILURES as error:
            raise ProbeError(self._name, probe, operation, error) from error
