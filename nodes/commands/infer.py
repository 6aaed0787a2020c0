"""``hierax infer``: the exact posteriors of a causal tree or polytree in a file."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hierax.runtime.commands.errors import CommandError
from hierax.runtime.commands.options import Format, OutputFormat
from hierax.runtime.commands.show import print_json, print_table
from hierax.runtime.core.errors import HieraxError
from hierax.runtime.loading.nearest import did_you_mean

if TYPE_CHECKING:
    from hierax.nodes.causal_tree import Network

MOST_DIGITS = 18  # of a state's number


def infer(
    network: Annotated[
        Path, typer.Argument(metavar="NETWORK", help="A causal tree or polytree: JSON, YAML, or BIF (with pyAgrum).")
    ],
    evidence: Annotated[
        list[str] | None,
        typer.Option(
            "--evidence",
            "-e",
            metavar="NAME=STATE",
            help="What is known of a node: a state's name or its number from 0, or likelihoods, one for each state, "
            "such as rain=[0.2,0.7]. May be given several times.",
        ),
    ] = None,
    output_format: OutputFormat = Format.text,
) -> int:
    """Print the posterior of every node of a Bayesian network, exactly."""
    from hierax.nodes.causal_tree import Inference, read_network

    read = read_network(network)
    _check_names(network, read.variables)
    inference = Inference(read)
    found = inference.update(_evidence(read, evidence or ()))
    variables = read.variables
    shares = {str(name): dict(zip(variables[name].states, row.tolist(), strict=True)) for name, row in found.items()}
    if output_format is Format.json:
        print_json({"file": str(network), "log_evidence": inference.log_evidence, "posteriors": shares})
        return 0
    print(f"{network}: {len(shares)} nodes, ln P(evidence) = {inference.log_evidence:.9g}", end="\n\n")
    rows = [
        (name if place == 0 else "", state, f"{share:.9g}")
        for name, row in shares.items()
        for place, (state, share) in enumerate(row.items())
    ]
    print_table({"node": {}, "state": {}, "probability": {"justify": "right"}}, rows)
    return 0


def _check_names(file: Path, names: Iterable[str | int]) -> None:
    """Raises HieraxError: two nodes' ids are one text, 1 and "1", which rows and --evidence could not tell apart."""
    known: dict[str, str | int] = {}
    for name in names:
        other = known.setdefault(str(name), name)
        if other != name:
            expected = f"expected ids that differ as texts, got {other!r} and {name!r}"
            raise CommandError(f"{file}: node {name!r}: id: {expected}")


def _evidence(network: "Network", given: Sequence[str]) -> dict[Any, Any]:
    """Evidence by node, as likelihoods. Raises HieraxError: an option is no evidence; says which one."""
    from hierax.nodes.causal_tree import likelihoods

    names = {str(name): name for name in network.variables}
    found: dict[Any, Any] = {}
    for option in given:
        text, _, value = (part.strip() for part in option.partition("="))
        where = f"--evidence {option}"
        if not value:
            raise CommandError(f"{where}: expected NAME=STATE, or NAME=[likelihood,…]")
        name = names.get(text)
        if name is None:
            raise CommandError(f"{where}: there is no node {text!r}{did_you_mean(text, names)}")
        if name in found:
            raise CommandError(f"{where}: node {text!r} has evidence already")
        try:
            found[name] = likelihoods(network, name, _value(value, network.variables[name].states))
        except HieraxError as error:
            raise CommandError(f"{where}: {error}") from error
    return found


def _value(text: str, states: Sequence[str]) -> Any:
    """What a user wrote: a state's name, its number, or likelihoods."""
    if text.isdecimal() and text not in states and len(text) <= MOST_DIGITS:
        return int(text)
    if text.startswith("[") and text.endswith("]") and text not in states:
        with suppress(ValueError):
            return [float(number) for number in text[1:-1].split(",")]
    return text
