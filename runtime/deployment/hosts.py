"""The hosts on which the nodes of a deployment run, and which node runs on which of them."""

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from hierax.runtime.deployment import models
from hierax.runtime.deployment.deployment import Document, Host, Keys
from hierax.runtime.loading.nearest import did_you_mean


def hosts_of(model: models.DeploymentModel, document: Document) -> dict[str, Host]:
    """The hosts by name. Raises `DeploymentError` if one cannot be what it says."""
    hosts = {}
    for name, said in model.hosts.items():
        if said.fallback is not None:
            _check_host(said.fallback, model.hosts, document, ("hosts", name, "fallback"))
        hosts[name] = Host(
            name,
            ssh=() if said.ssh is None else _words(said.ssh, document, ("hosts", name, "ssh")),
            python=said.python,
            folder=said.folder or "",
            address=said.address or "",
            labels=said.labels,
            fallback=said.fallback or "",
            lost_after_s=said.lost_after_s,
        )
    return hosts


def placed_on(model: models.DeploymentModel, hosts: Mapping[str, Host], document: Document) -> dict[str, str]:
    """The host of each node that has one. Raises `DeploymentError` if there is no such node, or no such host."""
    place = {}
    for name, where in model.place.items():
        keys = ("place", name)
        if name not in model.nodes:
            raise document.error(keys, f"there is no node {name!r}{did_you_mean(name, model.nodes, 'the nodes are')}")
        if isinstance(where, str):
            _check_host(where, hosts, document, keys)
            place[name] = where
        else:
            place[name] = _labelled(where, hosts, document, keys)
    return place


def check_together(processes: Mapping[str, Sequence[str]], placed: Mapping[str, str]) -> str:
    """What is wrong with nodes that are to share a process: that they are on several hosts; empty: nothing is."""
    for process, names in processes.items():
        found = {placed.get(name, "") for name in names}
        if len(found) > 1:
            where = ", ".join(f"{name} on {placed.get(name) or 'this machine'}" for name in names)
            return f"process {process!r} is on several hosts: {where}; expected one"
    return ""


def _labelled(wanted: Mapping[str, Any], hosts: Mapping[str, Host], document: Document, keys: Keys) -> str:
    """The first host of the file with some labels."""
    for name, host in hosts.items():
        if wanted.items() <= host.labels.items():
            return name
    known = "; ".join(f"{name} has {dict(host.labels)}" for name, host in hosts.items() if host.labels)
    raise document.error(keys, f"no host has the labels {dict(wanted)}; {known or 'no host has labels'}")


def _check_host(name: str, hosts: Mapping[str, object], document: Document, keys: Keys) -> None:
    if name not in hosts:
        known = did_you_mean(name, hosts, "the hosts are") or "; there are no hosts in this file"
        raise document.error(keys, f"there is no host {name!r}{known}")


def _words(said: str, document: Document, keys: Keys) -> tuple[str, ...]:
    try:
        words = tuple(shlex.split(said))
    except ValueError as error:
        raise document.error(keys, f"expected what `ssh` is told, such as pi@robot, got {said!r}: {error}") from error
    if not words or words[-1].startswith("-"):
        raise document.error(keys, f"expected a destination at the end, such as pi@robot, got {said!r}")
    return words
