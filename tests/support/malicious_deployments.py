"""Deployment files and snippets made to run code that they may not, or to fill the memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from support.deployments import TOYS, replaced
from support.malice import Attack, Place


def _written(text: str | bytes, *command: str) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        path = place.file("theirs.yaml", text)
        first, *options = command or ("validate",)
        return (first, str(path), *options)

    return made


def _attached(text: str) -> Callable[[Place], Sequence[str]]:
    def made(place: Place) -> Sequence[str]:
        path = place.file("snippet.yaml", text.format(ran=place.folder / "ran"))
        return ("run", str(place.deployment), "--epochs", "5", "--at", f"2:attach:{path}")

    return made


_LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12)
)
_CALL = "{{class: 'os:system', parameters: {{command: 'touch {ran}'}}}}"
DEPLOYMENTS = {
    "with a tag that calls": Attack(_written("hierarchy: !!python/object/apply:os.system ['touch ran']\n"), "tag"),
    "with a tag that makes": Attack(_written("hierarchy: !!python/name:os.system\n"), "tag"),
    "with a billion laughs": Attack(_written(_LAUGHS), "values"),
    "with a list in itself": Attack(_written("hierarchy: &a [*a]\n"), "nested"),
    "with merges of merges": Attack(
        _written("a0: &a0 {k: 1}\n" + "".join(
            f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}], k{n}: 1}}\n" for n in range(1, 20))), "<<"),
    "nested deep": Attack(_written("hierarchy: " + "[" * 100_000), "nested"),
    "with a number of a million digits": Attack(_written(f"hierarchy: x\nepochs: {'9' * 1_000_000}\n"), "whole number"),
    "of 100 MB": Attack(_written(b"# " + b"x" * (100 << 20)), "bytes"),
    "with characters that move the cursor": Attack(_written("hierarchy: \"\\e[2J\\e]0;x\\a\"\n"), "hierarchy"),
    "of a hierarchy called ../../precious": Attack(
        _written(replaced("hierarchy: toys", "hierarchy: ../../precious", TOYS)), "hierarchy"),
    "with a node called ../../precious": Attack(
        _written(replaced("  left: {class", "  ../../precious: {class", TOYS)), "precious"),
    "with a process called ../../precious": Attack(
        _written(TOYS + "processes: {../../precious: [left]}\n"), "precious"),
    "whose node is os.system": Attack(
        _written(replaced("class: support.toy_nodes:Counter", "class: posix:system", TOYS)), "expected a class"),
    "whose node is within a class": Attack(
        _written(replaced("class: support.toy_nodes:Counter", "class: 'support.toy_nodes:Counter.act.__globals__'",
                          TOYS)), "expected 'package.module:name'"),
    "that allows all of hierax": Attack(_written(TOYS + "modules: ['hierax.*']\n"), "modules"),
    "that is a device without an end": Attack(lambda place: ("validate", "/dev/zero"), "no file"),
    "a snippet that calls os.system": Attack(_attached(f"nodes:\n  top: {_CALL}\n"), "may not be loaded"),
    "a snippet with a tag that calls": Attack(
        _attached("nodes: !!python/object/apply:os.system ['touch {ran}']\n"), "tag"),
    "a snippet with a billion laughs": Attack(_attached(_LAUGHS), "values"),
    "a snippet with a node called ../../precious": Attack(
        _attached("nodes:\n  ../../precious: {{class: support.toy_nodes:Summer}}\n"), "precious"),
    "a snippet that allows modules": Attack(
        _attached(f"modules: [os]\nnodes:\n  top: {_CALL}\n"), ""),
    "a snippet whose edge calls os.system": Attack(
        _attached("nodes:\n  top: {{class: support.toy_nodes:Summer}}\nedges:\n  left -> top:\n"
                  "    sense: {{function: 'os:system', parameters: {{command: 'touch {ran}'}}}}\n"),
        "may not be loaded"),
}  # fmt: skip
