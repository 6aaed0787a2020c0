"""A dry epoch: every operator and edge function is called once, and nothing comes of it."""

from dataclasses import replace

from hierax.runtime.core.digest import travels
from hierax.runtime.deployment import Deployment
from hierax.runtime.engine.effects import Called
from hierax.runtime.execution import single
from hierax.runtime.execution.runner import NodeRunner
from hierax.runtime.watch.watcher import Watcher

MAX_POLICIES = 64  # of how many policies of a node every one is called


def run_dry(deployment: Deployment) -> int:
    """Do the first epoch in this process, from the initial beliefs: sense up, then predict down; where nodes take part
    in some epochs only, so many that each did once.

    No actuator is moved, no probe is told, and nothing is written. Policies that were not chosen are called, too, as
    are the metrics. Gives the number of calls of operators and edge functions; without an epoch, as the world has
    finished, only those of initial beliefs. Raises `HieraxError` if something cannot be loaded, or called, or gives
    what it must not."""
    counter = _Counter()
    runners: dict[str, NodeRunner] = {}

    def watch(name: str, runner: NodeRunner) -> None:
        runners[name] = runner
        runner.watch(counter)

    rates = deployment.roster.rates
    epochs = 1 if rates is None else rates.first_turns
    # what fails alone would be detached, and nothing said
    terms = {name: replace(each, on_loss="restart") for name, each in deployment.terms.items()}
    single.run(replace(deployment, probes=(), terms=terms), epochs=epochs, seed=0, watch=watch, acts=False)
    return len(runners) + counter.calls + sum(_call_other_policies(runner) for runner in runners.values())


def _call_other_policies(runner: NodeRunner) -> int:
    last = runner.observers.last
    if last is None:
        return 0
    step, node = last.step, runner.engine.node
    others = [policy for policy in sorted(node.policies) if policy != step.policy][:MAX_POLICIES]
    for policy in others:
        call = node.policies[policy]
        travels(call, step.epoch, "its actions", call.elements(step.epoch, step.time_s, step.sensed))
    return len(others)


class _Counter(Watcher):
    calls = 0

    def called(self, called: Called) -> None:
        self.calls += 1
