"""Hierarchies with rates, drawn from seeds, as deployment files, and changes of them, to be recorded."""

from __future__ import annotations

import random
from pathlib import Path

NODES = "hierax.runtime.sim.nodes"


def _functions(rng: random.Random, lower: str, upper: str) -> str:
    """An edge's functions and rates; what is gathered is sensed."""
    says = []
    for kind, chance in (("sense", 0.9), ("task", 0.5), ("context", 0.8)):
        if rng.random() < chance:
            mix = rng.choice(("Mix", "DrawingMix"))
            says.append(f'{kind}: {{function: "{NODES}:{mix}", parameters: {{name: {lower}-{upper}-{kind}}}}}')
    if rng.random() < 0.6:
        says.append(f"delay: {rng.randint(1, 6)}")
    if says[0].startswith("sense") and rng.random() < 0.5:
        says.append("gather: true")
    return f"  {lower} -> {upper}: {{{', '.join(says)}}}"


def _node(rng: random.Random, name: str, generation: int = 0) -> str:
    every = rng.choice((1, 2, 3, 5))
    turns = f"every: {every}, offset: {rng.randrange(every)}, " if every > 1 else ""
    parameters = f"name: {name}, policies: 2, generation: {generation}"
    return f'  {name}: {{{turns}class: "{NODES}:{rng.choice(("Mixer", "Drawer"))}", parameters: {{{parameters}}}}}'


def drawn(folder: Path, seed: int) -> Path:
    """A hierarchy of a world and four nodes, as a file."""
    rng = random.Random(seed)
    names = [f"n{number}" for number in range(4)]
    pairs = [("world", "n0")]
    for number, name in enumerate(names[1:], 1):
        below = ["world", *names[:number]]
        pairs += [(lower, name) for lower in rng.sample(below, rng.randint(1, 2))]
    world = f'  world: {{class: "{NODES}:MixingWorld", parameters: {{name: world}}}}'
    nodes = [world, *(_node(rng, name) for name in names)]
    head = "hierarchy: drawn\nworld: world\nrates: true\nnodes:"
    path = folder / f"drawn-{seed}.yaml"
    path.write_text("\n".join([head, *nodes, "edges:", *(_functions(rng, *pair) for pair in pairs), ""]))
    return path


def changes(folder: Path, seed: int) -> list[str]:
    """What `--at` has of a run of such a one: two nodes that come, others in the place of two, one that goes."""
    rng = random.Random(f"{seed}/changes")
    schedule, epoch = [], 0
    for number, words in enumerate(("attach top n0", "replace n1", "replace n3", "detach top", "attach top n2")):
        epoch += rng.randint(2, 9)
        kind, name, *lower = words.split()
        path = folder / f"change-{seed}-{number}.yaml"
        edges = ["edges:", *(_functions(rng, each, name) for each in lower)] if lower else []
        path.write_text("\n".join(["nodes:", _node(rng, name, generation=number), *edges, ""]))
        named = {"attach": f"attach:{path}", "replace": f"replace:{name}:{path}", "detach": f"detach:{name}"}
        schedule.append(f"{epoch}:{named[kind]}")
    return schedule
