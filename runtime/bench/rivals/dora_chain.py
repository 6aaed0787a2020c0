"""The chain in dora: its daemon starts the nodes, which send Arrow arrays; large ones go through its shared memory."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from dora import Node

from hierax.runtime.bench.rivals.stopwatch import Stopwatch, look, options

INPUTS = {
    "world": {"down": "arm/down"},
    "arm": {"up": "world/up", "picture": "spatial/down"},
    "spatial": {"up": "arm/up"},
}
OUTPUTS = {"world": ["up"], "arm": ["up", "down"], "spatial": ["down"]}


def run_world(node: Any, epochs: int) -> None:
    """Send up, and time what comes down; a first epoch that nobody heard is begun again."""
    stopwatch = Stopwatch(epochs)
    times = Path("times")

    def begin() -> None:
        count, level = stopwatch.begin()
        node.send_output("up", pa.array([level]), {"count": count})

    begin()
    for event in node:
        if event["type"] == "INPUT" and stopwatch.end(event["metadata"]["count"]):
            begin()
        if stopwatch.done:
            times.write_text(json.dumps(stopwatch.times_us))
            return


def run_arm(node: Any) -> None:
    """Pass on."""
    for event in node:
        if event["type"] != "INPUT":
            return
        metadata = {"count": event["metadata"]["count"]}
        if event["id"] == "up":
            node.send_output("up", event["value"], metadata)
            continue
        value = event["value"]
        if "level" in event["metadata"]:
            look(value.to_numpy(zero_copy_only=True))
            value = pa.array([event["metadata"]["level"]])
        node.send_output("down", value, metadata)


def run_spatial(node: Any, picture: int) -> None:
    """Answer."""
    pixels = pa.array(np.ones(picture, np.uint8))
    for event in node:
        if event["type"] != "INPUT":
            return
        metadata = {"count": event["metadata"]["count"]}
        if picture:
            metadata["level"] = event["value"][0].as_py()
        node.send_output("down", pixels if picture else event["value"], metadata)


def main() -> None:
    """Be one of the nodes, or have the daemon start them."""
    given = options(*INPUTS)
    if given.role == "world":
        run_world(Node(), given.epochs)
    elif given.role == "arm":
        run_arm(Node())
    elif given.role == "spatial":
        run_spatial(Node(), given.picture)
    else:
        start(given.epochs, given.picture)


def start(epochs: int, picture: int) -> None:
    """Have all nodes run, and print the world's times."""
    program = f"-m hierax.runtime.bench.rivals.dora_chain --epochs {epochs} --picture {picture} --role"
    with tempfile.TemporaryDirectory(prefix="hierax-bench-") as folder:
        nodes = [
            {
                "id": role,
                "path": sys.executable,
                "args": f"{program} {role}",
                "inputs": inputs,
                "outputs": OUTPUTS[role],
            }
            for role, inputs in INPUTS.items()
        ]
        (Path(folder) / "chain.yml").write_text(json.dumps({"nodes": nodes}))
        dora = Path(sys.executable).with_name("dora")
        subprocess.run([dora, "run", "chain.yml"], cwd=folder, check=True, stdout=sys.stderr)
        times = next(Path(folder).rglob("times"))
        print(times.read_text(), flush=True)


if __name__ == "__main__":
    main()
