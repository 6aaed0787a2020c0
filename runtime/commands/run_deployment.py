"""What ``run`` and ``launch`` have in common: options to a report, printed and kept."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import replace

from hierax.runtime.commands.ctrl_c import INTERRUPTED
from hierax.runtime.commands.errors import OK, interrupted, notify
from hierax.runtime.commands.options import Format, RunOptions
from hierax.runtime.commands.show import print_json, print_report
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.execution.output_folder import claimed_output, write_summary
from hierax.runtime.execution.pacemaker import called
from hierax.runtime.execution.report import Interrupted, Report
from hierax.runtime.host.private_files import check_encodable
from hierax.runtime.loading.loader import extend_import_path
from hierax.runtime.watch.prints import NamedLines

Runner = Callable[..., Report]  # `hierax.runtime.execution.single.run` or `hierax.runtime.launch.supervisor.launch`


def run_deployment(runner: Runner, file: str, options: RunOptions, goes_on: bool = False) -> int:
    """Read a deployment, run it, print its report; it is kept where an epoch was committed.

    `goes_on`: whether the run that is there is resumed. Returns the exit code: 0, or 130 where a signal has broken the
    run off; its report is printed and kept all the same. Raises `HieraxError` if the file is wrong, the output folder
    cannot be made, or the run failed."""
    deployment = read_deployment(file, options.overrides or ())
    probes = tuple(replace(each, overwrite=options.overwrite) for each in deployment.probes)
    deployment = replace(deployment, probes=probes)
    extend_import_path(deployment.import_paths)
    limit = deployment.epochs if options.epochs is None else options.epochs
    output, code = options.output, OK
    check_encodable(output or "")
    prints = NamedLines(sys.stderr, lambda: called(sys._getframe()))
    with nullcontext() if output is None else claimed_output(output, options.overwrite, goes_on):
        try:
            # what a node prints must not mix with the report
            with deployment.explaining(), _progress(deployment.name, limit) as progress, redirect_stdout(prints):
                report = runner(deployment, epochs=limit, seed=options.seed, output=output, progress=progress)
        except Interrupted as broken:
            report, code = broken.report, INTERRUPTED
        if output is not None and (code == OK or report.epochs):
            write_summary(output, report)
    if options.output_format is Format.json:
        print_json(report.plain())
    else:
        print_report(report)
    if code == INTERRUPTED:
        for name, why in report.unreported.items():
            notify(f"{name}: its state after epoch {report.epochs} is not told: {why}")
        return interrupted()
    return code


@contextmanager
def _progress(name: str, limit: int | None) -> Iterator[Callable[[int, bytes], None] | None]:
    """A progress bar on standard error, where that is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=limit)

        def show(epoch: int, _: bytes) -> None:
            bar.update(task, completed=epoch)

        yield show
