"""Processes that share a campaign's work, one for each core.

Not those of `multiprocessing`: these look for modules in the current folder first, and Ctrl-C has each of them write
a traceback.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from queue import SimpleQueue
from typing import Any

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.host.streams import python_module, started_deaf


def done_by_workers(function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """What a module's function gives for each task, in order, in other processes. Raises `HieraxError` if one ended."""
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        workers: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
        for _ in range(jobs):  # they end before the threads that wait for them are waited for
            workers.put(stack.enter_context(_worker()))
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)

        def do(task: tuple[Any, ...]) -> Any:
            worker = workers.get()
            try:
                return _ask(worker, (function, task))
            finally:
                workers.put(worker)

        for future in [pool.submit(do, task) for task in tasks]:
            yield future.result()


@contextmanager
def _worker() -> Iterator[subprocess.Popen[bytes]]:
    command = python_module("hierax.runtime.sim.workers")
    with started_deaf():
        worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    try:
        yield worker
    finally:
        worker.kill()
        with suppress(BrokenPipeError), worker:  # which waits, and closes its pipes
            pass


def _ask(worker: subprocess.Popen[bytes], question: Any) -> Any:
    assert worker.stdin is not None
    assert worker.stdout is not None
    try:
        pickle.dump(question, worker.stdin)
        worker.stdin.flush()
        return pickle.load(worker.stdout)
    except (EOFError, OSError, pickle.UnpicklingError) as error:
        raise HieraxError(f"a process that simulates has ended, with exit code {worker.wait()}") from error


def main() -> None:
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(EOFError, BrokenPipeError):  # nobody asks any more
        while True:
            function, task = pickle.load(sys.stdin.buffer)
            pickle.dump(function(*task), answers)
            answers.flush()


if __name__ == "__main__":
    main()
