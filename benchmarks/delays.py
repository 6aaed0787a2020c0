"""A loop of three nodes at 100 Hz, and above it one that takes 0.3 s: what the loop notices of it.

    python benchmarks/delays.py                # ten minutes
    python benchmarks/delays.py --rounds 3
    python benchmarks/delays.py --rounds 9 --kinds waits    # only where it waits for a service

In turn, `--rounds` times: without the slow node, with the barrier and where a node with rates may come later (`rates:
true`); with it, each 60th epoch and with 60 epochs of time; and with 20 of both, which is too little, so that it is
waited for. Then the same with an operator that computes in numpy. Prints how long epochs take, ratios to both of those
without it (medians of the rounds), and overruns; digests have to be those of `hierax run`. Exit code 1 where one is
not, where there are overruns at 60, or none at 20, or where below a service with 60 epochs' time the median or the
99th percentile of the loop's epochs is more than a tenth longer than that of the loop alone, with the barrier.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from support.launched import hierax

EPOCHS = 600
NODES = """
hierarchy: deliberating
world: world
nodes:
  world: {class: "support.mixing_nodes:MixingWorld", rate_hz: 100}
  reflex: {class: "support.mixing_nodes:Mixing"}
  posture: {class: "support.mixing_nodes:Mixing"}
"""
EDGES = """
edges:
  world -> reflex: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told"}
  reflex -> posture: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told"}
"""
MIND = """
  mind: {class: "support.mixing_nodes:CLASS", parameters: {takes_s: 0.3}, every: EVERY, scheduling: {policy: POLICY}}
"""
ABOVE = """
  posture -> mind: {sense: "support.mixing_nodes:told", context: "support.mixing_nodes:told", delay: EVERY}
"""
SLOW = NODES + MIND + EDGES + ABOVE
KINDS = (
    ("waits for a service", "Asking", "other"),
    ("computes", "Computing", "other"),
    ("computes and gives way", "Computing", "idle"),
)
MOST = 1.1  # times the loop alone
HELD = "waits for a service, every 60"
ALONE, ALONE_RATED = "the loop alone", "the loop alone, rates: true"
CASES = {
    ALONE: NODES + EDGES,
    ALONE_RATED: "rates: true" + NODES + EDGES,
    **{
        f"{kind}, every {every}": SLOW.replace("CLASS", name).replace("POLICY", policy).replace("EVERY", str(every))
        for kind, name, policy in KINDS
        for every in (60, 20)
    },
}


def main() -> int:
    """Launch them in turn, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--kinds", default="", metavar="BEGINNING", help="of the slow nodes those that begin so")
    options = parser.parse_args()
    cases = {case: text for case, text in CASES.items() if case.startswith(("the loop alone", options.kinds))}
    found: dict[str, list[dict[str, Any]]] = {case: [] for case in cases}
    wanted = {case: said("run", text)["digest"] for case, text in cases.items()}
    faults = 0
    for _ in range(options.rounds):
        for case, text in cases.items():
            found[case].append(said("launch", text))
            faults += found[case][-1]["digest"] != wanted[case]
    print(f"{'':32} {'p50, µs':>8} {'p99, µs':>8}   to it alone: p50, p99   with rates: p50, p99   overruns")
    for case, reports in found.items():
        p50, p99 = (statistics.median(times_of(reports, what)) for what in ("p50", "p99"))
        ratios = [ratio(reports, found[other], what) for other in (ALONE, ALONE_RATED) for what in ("p50", "p99")]
        overruns = [sum(overruns_of(each).values()) for each in reports]
        too_few = case.endswith(" 20") and not min(overruns)
        faults += too_few or (case.endswith(" 60") and max(overruns) > 0) or (case == HELD and max(ratios[:2]) > MOST)
        print(f"{case:32} {p50:8.0f} {p99:8.0f}", *(f"{each:10.2f}" for each in ratios), f"  {overruns}")
    return int(faults > 0)


def times_of(reports: list[dict[str, Any]], what: str) -> list[float]:
    """How long epochs took, µs, by round."""
    return [each["epoch_us"][what] for each in reports]


def ratio(reports: list[dict[str, Any]], others: list[dict[str, Any]], what: str) -> float:
    """The median of the rounds' ratios."""
    rounds = zip(times_of(reports, what), times_of(others, what), strict=True)
    return statistics.median(ours / theirs for ours, theirs in rounds)


def overruns_of(report: dict[str, Any]) -> dict[str, int]:
    """By who has waited."""
    overruns = (report.get("timing") or {}).get("overruns", {})
    return dict(overruns.get("mind", {}))


def said(command: str, text: str) -> dict[str, Any]:
    """What a command says of a deployment."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "deliberating.yaml"
        file.write_text(text, encoding="utf-8")
        return hierax(command, str(file), "--epochs", str(EPOCHS))


if __name__ == "__main__":
    sys.exit(main())
