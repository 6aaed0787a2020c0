"""Runs that a script goes through epoch by epoch: in this process, or with each node in a process of its own."""

import atexit
import logging
import queue
import sys
import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, cast

from hierax.runtime.core.elements import Value
from hierax.runtime.core.errors import HierarchyError, HieraxError
from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import Document, ProcessTerms
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.deployment.snippet import attach_of, replace_of, terms_of
from hierax.runtime.deployment.written import yaml_of
from hierax.runtime.execution.output_folder import claimed_output, write_summary
from hierax.runtime.execution.report import Interrupted, Report
from hierax.runtime.execution.single import SingleRun
from hierax.runtime.host.zenoh_settings import names_file
from hierax.runtime.launch.recorder_process import RecordingRequest
from hierax.runtime.launch.supervisor import launch as launch_processes
from hierax.runtime.loading.allowance import module_of, references
from hierax.runtime.loading.loader import extend_import_path
from hierax.runtime.loading.nearest import did_you_mean
from hierax.runtime.recording.info import RunInfo
from hierax.runtime.recording.recorder import InProcess, Recorder
from hierax.runtime.recording.topics import EVERYTHING
from hierax.runtime.recording.writing import Target, claimed
from hierax.runtime.scripting.hierarchy import Hierarchy
from hierax.runtime.transport.launch_client import LaunchClient
from hierax.runtime.transport.port import TransportError
from hierax.schemas.limits import LARGEST
from hierax.schemas.roster import Change, Detach

_ENDS_S = 5.0  # how long a launch of which a process does not answer may take to be over
_MOST_TOLD = 10_000  # how many epochs wait until somebody iterates over them; of more than that the oldest are left out

_log = logging.getLogger("hierax")


class Epoch(NamedTuple):
    """An epoch that is committed."""

    number: int  # from 1 on
    digest: str  # of all up to it, hexadecimal; the same in every kind of run


class Run(ABC):
    """A run; iterating over it gives its epochs. As a context manager it is ended when the block is left.

    A run in this process goes on only while it is iterated over; a launch goes on by itself, and epochs are told as
    they come, of which one may be missing where this machine has no time to tell it."""

    def __init__(self, deployment: Deployment, stack: ExitStack) -> None:
        self.deployment = deployment  # what is run
        self._stack = stack  # what is given back at the end

    def __iter__(self) -> Iterator[Epoch]:
        return self

    def __enter__(self) -> "Run":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    @abstractmethod
    def __next__(self) -> Epoch:
        """Wait for the next epoch. Raises `HieraxError` if the run failed."""

    @abstractmethod
    def belief(self, name: str) -> Value:
        """What a node believes now. Raises `HieraxError` if there is none of this name, or it does not answer."""

    @abstractmethod
    def close(self) -> None:
        """End the run where it is; nothing is left of it but what it has written."""

    @abstractmethod
    def _change(self, change: Change, terms: Mapping[str, ProcessTerms]) -> int:
        """Have the roster change; gives the first epoch under it."""

    @abstractmethod
    def _report(self) -> Report:
        """What it has come to; it is at its end."""

    def report(self) -> Report:
        """Go on to the end; gives what the run has come to. Raises `HieraxError` if it failed."""
        try:
            for _ in self:
                pass
            report = self._report()
        except BaseException:  # also where Ctrl-C ends the wait
            self.close()
            raise
        if report.output is not None:
            write_summary(report.output, report)
        self.close()
        return report

    def attach(self, part: Hierarchy) -> int:
        """Attach nodes while it runs; gives the first epoch with them.

        Args:
            part: the nodes, and edges that join them to each other and to what runs.

        Raises:
            HieraxError: it is refused; nothing has changed then.
        """
        document = _snippet(part, self.deployment)
        return self._change(attach_of(document), terms_of(document, self.deployment, attached=True))

    def detach(self, name: str, *, cascade: bool = False) -> int:
        """Detach a node while it runs, `cascade`: also what only it joins to the world; gives the first epoch without
        it. Raises `HieraxError` if it is refused."""
        return self._change(Detach(name, cascade), {})

    def replace(self, name: str, part: Hierarchy) -> int:
        """Have another node take a node's place and belief; gives the first epoch with it.

        Args:
            name: of the node.
            part: has one node of that name, and all its edges from then on; without edges it keeps those it has.

        Raises:
            HieraxError: it is refused.
        """
        document = _snippet(part, self.deployment)
        return self._change(replace_of(document, name), terms_of(document, self.deployment))


class _Local(Run):
    """In this process: deterministic, in virtual time."""

    def __init__(self, deployment: Deployment, stack: ExitStack, single: SingleRun) -> None:
        super().__init__(deployment, stack)
        self._single = single
        self._epochs = single.epochs()
        self._failure: Exception | None = None
        stack.callback(single.close)
        weakref.finalize(self, stack.close)  # also at the end of the script: a recording is whole then

    def __next__(self) -> Epoch:
        if self._failure is not None:
            raise self._failure
        try:
            with self.deployment.explaining():
                number, digest = next(self._epochs)
        except StopIteration:
            raise
        except BaseException as error:
            broken = HieraxError(f"the run was broken off ({type(error).__name__})")
            self._failure = error if isinstance(error, Exception) else broken
            raise
        return Epoch(number, digest.hex())

    def belief(self, name: str) -> Value:
        return self._single.node_report(name).belief

    def close(self) -> None:
        self._epochs = iter(())
        self._stack.close()

    def _change(self, change: Change, terms: Mapping[str, ProcessTerms]) -> int:
        return self._single.change(change, terms)

    def _report(self) -> Report:
        if self._failure is not None:
            raise self._failure
        return self._single.report()


class _Launched(Run):
    """Each node in a process of its own, kept by a thread of this one."""

    def __init__(self, deployment: Deployment, stack: ExitStack, options: Mapping[str, Any]) -> None:
        super().__init__(deployment, stack)
        self._told: queue.SimpleQueue[Epoch | None] = queue.SimpleQueue()
        self._place: Future[tuple[str, str] | None] = Future()  # where it is asked, and its secret; None: never
        self._end = threading.Event()
        self._failure: BaseException | None = None
        self._result: Report | None = None
        self._client: LaunchClient | None = None
        self._thread = threading.Thread(target=self._keep, args=(options,), name="hierax-launch", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # Python kills threads that are left, and where one is in Zenoh aborts with it

    def _keep(self, options: Mapping[str, Any]) -> None:
        def tell(number: int, digest: bytes) -> None:
            if self._told.qsize() >= _MOST_TOLD:  # nobody iterates, or not as fast
                with suppress(queue.Empty):
                    self._told.get_nowait()
            self._told.put(Epoch(number, digest.hex()))

        try:
            with self.deployment.explaining():
                self._result = launch_processes(
                    self.deployment,
                    progress=tell,
                    notify=_log.warning,
                    opened=lambda endpoint, secret: self._place.set_result((endpoint, secret)),
                    broken=self._end,
                    **options,
                )
        except Interrupted as broken:
            self._result = broken.report
        except KeyboardInterrupt:
            pass  # `close` has ended it before its nodes were up
        except HieraxError as error:  # what went wrong, did so in another process: how it got here tells nothing
            error.__cause__ = None
            self._failure = error.with_traceback(None)
        except BaseException as error:
            self._failure = error
        finally:
            if not self._place.done():
                self._place.set_result(None)
            self._told.put(None)

    def __next__(self) -> Epoch:
        epoch = self._told.get()
        if epoch is not None:
            return epoch
        self._told.put(None)
        self._thread.join()
        if self._failure is not None and not self._end.is_set():
            raise self._failure
        raise StopIteration

    def belief(self, name: str) -> Value:
        """Of a run that has come to its end, what it believed last."""
        try:
            if self._thread.is_alive():
                client = self._asked()
                return cast(Value, client.node_state(client.status(), name)["belief"])
        except TransportError:
            self._thread.join(_ENDS_S)  # its processes are about to go
            if self._thread.is_alive():
                raise
        nodes = self._report().nodes
        if name not in nodes:
            raise HieraxError(f"there is no node {name!r}{did_you_mean(name, nodes, 'the nodes are')}")
        return nodes[name].belief

    def close(self) -> None:
        atexit.unregister(self.close)
        self._end.set()
        self._thread.join()
        if self._client is not None:
            self._client.close()
            self._client = None
        self._stack.close()

    def _change(self, change: Change, terms: Mapping[str, ProcessTerms]) -> int:
        return int(self._asked().change(change, terms)["epoch"])

    def _asked(self) -> LaunchClient:
        """What asks the launch, once its nodes are up. Raises why they never are."""
        if self._client is None:
            place = self._place.result()
            if place is None:
                raise self._failure or TransportError("the run was ended before it had begun")
            if not self._thread.is_alive():
                raise TransportError("the run is over")
            endpoint, secret = place
            self._client = LaunchClient(endpoint, secret=secret)
        return self._client

    def _report(self) -> Report:
        if self._result is None:
            raise self._failure or HieraxError("the run was ended before it had begun")
        return self._result


def run(
    what: Hierarchy | str | Path,
    *,
    epochs: int | None = None,
    seed: int = 0,
    settings: Sequence[str] = (),
    output: str | Path | None = None,
    record: str | Path | None = None,
    overwrite: bool = False,
) -> Run:
    """Run a hierarchy in this process: deterministic, in virtual time, a step at a time.

    Args:
        what: a hierarchy, a deployment file, or the name of a shipped one.
        epochs: how many; None: as the deployment says, or until the world has finished.
        seed: of all random numbers, and of the order in which messages are delivered.
        settings: of a file, ``PATH=VALUE`` as ``--set`` has them.
        output: a folder for states, digests and what probes write.
        record: a file for a recording (needs the package ``mcap``).
        overwrite: whether what is in `output` and `record` already is replaced.

    Raises:
        HieraxError: the hierarchy is wrong, a node cannot be loaded, or something cannot be written.
    """
    with ExitStack() as stack:
        deployment, target, folder = _prepared(stack, what, epochs, seed, settings, output, record, overwrite)
        recording = None
        if target is not None:
            info = RunInfo.of(deployment, token_hex(4), "run", seed, settings, from_start=True)
            recording = InProcess(Recorder(info, target, False, EVERYTHING))
            stack.callback(recording.finish)
        with deployment.explaining():
            single = SingleRun(deployment, epochs=epochs, seed=seed, output=folder, record=recording)
        return _Local(deployment, stack.pop_all(), single)
    raise AssertionError  # pragma: no cover - `with` never swallows


def launch(
    what: Hierarchy | str | Path,
    *,
    epochs: int | None = None,
    seed: int = 0,
    settings: Sequence[str] = (),
    output: str | Path | None = None,
    record: str | Path | None = None,
    overwrite: bool = False,
) -> Run:
    """Run a hierarchy over Zenoh, each node in a process of its own; it begins at once.

    Arguments and errors are those of `run`; what goes wrong later is raised where epochs are waited for. A script that
    launches its own classes guards what it does by ``if __name__ == "__main__":``, as processes import it."""
    with ExitStack() as stack:
        deployment, target, folder = _prepared(stack, what, epochs, seed, settings, output, record, overwrite)
        if isinstance(what, Hierarchy):
            alien = sorted(target for target in what.targets() if target.startswith("__main__:"))
            if alien:
                where = "is defined where no other process can import it; write it into a module"
                raise HierarchyError(f"{alien[0].partition(':')[2]} {where} (in a notebook: %%writefile nodes.py)")
        _check_not_imported(deployment)
        recording = None if target is None else RecordingRequest(target, check=False)
        overrides = tuple(settings)
        options = {"epochs": epochs, "seed": seed, "output": folder, "overrides": overrides, "recording": recording}
        return _Launched(deployment, stack.pop_all(), options)
    raise AssertionError  # pragma: no cover - `with` never swallows


def _check_not_imported(deployment: Deployment) -> None:
    """Raise `HierarchyError` where a module is being imported from which the launch's own processes would import code:
    each of them would launch it once more."""
    for module in {module_of(reference.target) for _, reference in references(deployment.roster)}:
        if getattr(getattr(sys.modules.get(module), "__spec__", None), "_initializing", False):
            guard = "guard what it does as a script by `if __name__ == '__main__':`"
            raise HierarchyError(f"{module} launches {deployment.name!r} while it is imported; {guard}")


def _snippet(part: Hierarchy, deployment: Deployment) -> Document:
    """What a part says. Raises `HierarchyError` if it is none."""
    if not isinstance(part, Hierarchy):
        raise HierarchyError(f"expected a hierax.Hierarchy with what is to be there, got {part!r:.80}")
    return part.snippet(deployment)


def _prepared(
    stack: ExitStack,
    what: Hierarchy | str | Path,
    epochs: int | None,
    seed: int,
    settings: Sequence[str],
    output: str | Path | None,
    record: str | Path | None,
    overwrite: bool,
) -> tuple[Deployment, Target | None, Path | None]:
    """What is run, and the places that are written to, which the run has for itself."""
    for name, value, least in (("epochs", epochs, 1), ("seed", seed, 0)):
        if value is not None and not (isinstance(value, int) and least <= value <= LARGEST):
            raise HierarchyError(f"{name}: expected a whole number from {least} to {LARGEST}, got {value!r:.80}")
    if isinstance(settings, (str, Mapping)) or not all(isinstance(each, str) for each in settings):
        raise HierarchyError(f"settings: expected a list of texts PATH=VALUE, got {settings!r:.80}")
    if isinstance(what, Hierarchy) and settings:
        raise HierarchyError(
            "settings are for deployment files; a Hierarchy is given its parameters by functools.partial"
        )
    if isinstance(what, Hierarchy):  # tools and recordings read its file
        home = Path(stack.enter_context(TemporaryDirectory(prefix="hierax-"))) / f"{what.name}.yaml"
        deployment = replace(what.deployment(), path=home)
        moved = {"zenoh": deployment.zenoh} if names_file(deployment.zenoh) else {}  # which is not beside that file
        home.write_text(yaml_of({**what.root(), **moved}), encoding="utf-8")
    else:
        deployment = read_deployment(what, settings)
    probes = tuple(replace(each, overwrite=overwrite) for each in deployment.probes)
    deployment = replace(deployment, probes=probes)
    extend_import_path(deployment.import_paths)
    folder = None if output is None else Path(output)
    if folder is not None:
        stack.enter_context(claimed_output(folder, overwrite))
    target = None
    if record is not None:
        target = stack.enter_context(claimed(Path(record), overwrite))
    return deployment, target, folder
