"""``hierax sim``: runs under simulated faults, and whether all that must hold does."""

import time
from typing import TYPE_CHECKING, Annotated

from hierax.runtime.commands.errors import FAILED, OK, CommandError
from hierax.runtime.commands.options import Format, OutputFormat, option
from hierax.runtime.commands.show import print_json, show_progress
from hierax.runtime.loading.nearest import did_you_mean
from hierax.schemas.limits import LARGEST

if TYPE_CHECKING:
    from hierax.runtime.sim.campaign import Scenarios, Summary
    from hierax.runtime.sim.scenario import Scenario

SHOWN = 10  # how many violations are shown as text

ENOUGH = 1000
"""Of so many seeds, with all faults, each kind of order, word, message, verdict, change and fault has to be reached."""

TRACE_LINES = 80  # how many of a failing simulation's last events are shown


def sim(
    seeds: Annotated[str, option("--seeds")] = "0:1000",
    faults: Annotated[str | None, option("--faults")] = None,
    epochs: Annotated[
        int | None, option("--epochs", min=1, max=LARGEST, help="In each simulation; by default the seed decides.")
    ] = None,
    jobs: Annotated[int | None, option("--jobs", min=1)] = None,
    rates: Annotated[bool, option("--rates")] = False,
    trace: Annotated[bool, option("--trace")] = False,
    output_format: OutputFormat = Format.text,
) -> int:
    """Simulate runs with crashes, losses, hangs and partitions; shows what does not hold, made small."""
    from hierax.runtime.sim.campaign import Scenarios, cores, simulate_many
    from hierax.runtime.sim.scenario import FAULTS

    wanted = _seeds(seeds)
    kinds = _kinds(faults, rates)
    scenarios = Scenarios(kinds, epochs, rates)
    if trace and output_format is Format.json:
        raise CommandError("--trace: it is printed as text; expected no --format json beside it")
    if trace:
        return _trace(wanted, scenarios)
    began = time.monotonic()

    def show(summary: "Summary") -> None:
        show_progress(f"\r{summary.seeds} of {len(wanted)} seeds, {len(summary.violations)} violations", end="")

    summary = simulate_many(wanted, scenarios, jobs or cores(), show)
    show_progress("")
    if output_format is Format.json:
        print_json(summary.plain())
    else:
        _print(summary, time.monotonic() - began)
        if summary.violations:
            _print_smallest(scenarios.draw(min(summary.violations)[0]))
    if summary.violations:
        return FAILED
    unreached = summary.unreached(rates)
    if len(wanted) >= ENOUGH and kinds == FAULTS and epochs is None and unreached:
        raise CommandError(f"no seed has reached {', '.join(unreached)}: the scenarios are too tame")
    return OK


def _seeds(text: str) -> range:
    first, colon, end = text.partition(":")
    try:
        seeds = range(int(first), int(end) if colon else int(first) + 1)
    except ValueError as error:
        raise CommandError(f"--seeds {text}: expected two whole numbers, A:B, or one") from error
    if seeds.stop > LARGEST:
        raise CommandError(f"--seeds {text:.80}: expected numbers below {LARGEST}")
    if not seeds or seeds[0] < 0:
        raise CommandError(f"--seeds {text}: expected numbers from 0, the second greater than the first")
    return seeds


def _kinds(text: str | None, rates: bool) -> tuple[str, ...]:
    from hierax.runtime.sim.scenario import FAULTS, RATED_FAULTS

    if text is None:
        return FAULTS
    if text == "none":
        return ()
    kinds = tuple(text.split(","))
    for kind in kinds:
        if kind not in FAULTS:
            raise CommandError(f"--faults: there is no {kind!r}{did_you_mean(kind, FAULTS, 'the kinds are')}")
        if rates and kind not in RATED_FAULTS:
            raise CommandError(f"--faults: {kind!r} cannot occur with --rates: no node fails alone there")
    return kinds


def _trace(seeds: range, scenarios: "Scenarios") -> int:
    from hierax.runtime.sim.campaign import simulate_quietly

    if len(seeds) != 1:
        raise CommandError("--trace: expected a single seed")
    lines: list[str] = []
    result = simulate_quietly(scenarios.draw(seeds[0]), lines)
    print("\n".join(lines))
    print(result.violation or "nothing is wrong")
    return FAILED if result.violation else OK


def _print(summary: "Summary", wall_s: float) -> None:
    print(f"{summary.seeds} seeds in {wall_s:.1f} s, {summary.epochs} epochs")
    width = max(len(kind) for kinds in summary.kinds.values() for kind in kinds)
    for group, kinds in summary.kinds.items():
        for kind, count in kinds.items():
            print(f"  {group:<8} {kind:<{width}} {count:>10}")
    changes = ", ".join(f"{count} {what}" for what, count in sorted(summary.answers.items()))
    print(f"changes: {changes or 'none'}; runs that gave up, as they may: {summary.stopped}")
    print(f"violations: {len(summary.violations)}")
    for seed, what in sorted(summary.violations)[:SHOWN]:
        print(f"  seed {seed}: {what}")


def _print_smallest(failing: "Scenario") -> None:
    """The first failing scenario, as small as it can be made, with the end of its trace."""
    from hierax.runtime.sim.campaign import fails, shrink, simulate_quietly

    scenario = shrink(failing, fails)
    lines: list[str] = []
    result = simulate_quietly(scenario, lines)
    print(f"\nseed {scenario.seed}, made small: {scenario.epochs} epochs, {len(scenario.roster.nodes)} nodes")
    for what in (*scenario.faults, *scenario.proposals):
        print(f"  {what}")
    print("\n".join(lines[-TRACE_LINES:]))
    print(result.violation)
