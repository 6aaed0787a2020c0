"""What it costs that a launch is closed, and that it is encrypted: the same hierarchy in all ways in turn.

    python benchmarks/closed.py                  # 15 launches each
    python benchmarks/closed.py --rounds 3 --epochs 500

Prints medians over the rounds, of the epochs' p50 and of the time until the first epoch, and ratios to an open launch.
Exit code 1 where an epoch of a closed one takes more than 1.1 times as long.
"""

import argparse
import statistics
import sys

from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.launch.supervisor import launch

CLOSED_COSTS = 1.1  # times an open launch, at most
WAYS = {"open": None, "closed": None, "encrypted": "127.0.0.1"}  # where other machines may join


def main() -> int:
    """Measure in turn, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--epochs", type=int, default=2000)
    parser.add_argument("--deployment", default="chain")
    options = parser.parse_args()
    epochs_us: dict[str, list[float]] = {way: [] for way in WAYS}
    starts_s: dict[str, list[float]] = {way: [] for way in WAYS}
    for number in range(options.rounds):
        for way, host in WAYS.items() if number % 2 else reversed(WAYS.items()):
            deployment = read_deployment(options.deployment, [f"open={str(way == 'open').lower()}"])
            report = launch(deployment, epochs=options.epochs, seed=0, host=host)
            epochs_us[way].append(1e6 * statistics.median(report.epochs_s))
            starts_s[way].append(report.start_s)
    for what, found, unit in (("epoch p50", epochs_us, "µs"), ("start", starts_s, "s")):
        opened = statistics.median(found["open"])
        print(f"{what}: open {opened:.4g} {unit}")
        for way in ("closed", "encrypted"):
            ratios = sorted(one / other for one, other in zip(found[way], found["open"], strict=True))
            median = statistics.median(found[way])
            print(
                f"  {way} {median:.4g} {unit}, ratio {median / opened:.3f} "
                f"(by rounds {ratios[0]:.3f} to {ratios[-1]:.3f}, median {statistics.median(ratios):.3f})"
            )
    ratios = [one / other for one, other in zip(epochs_us["closed"], epochs_us["open"], strict=True)]
    return int(statistics.median(ratios) > CLOSED_COSTS)


if __name__ == "__main__":
    sys.exit(main())
