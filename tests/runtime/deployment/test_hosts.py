"""Hosts and places in a deployment file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hierax.runtime.deployment import Deployment
from hierax.runtime.deployment.deployment import DeploymentError, Host
from hierax.runtime.deployment.read import read_deployment

HOSTS = """\
hosts:
  robot: {ssh: "-p 2222 pi@robot", python: ~/venv/bin/python, fallback: desk, lost_after: 3, labels: {arm: true}}
  desk: local
  tower: {labels: {gpu: true, ram_gb: 64}, ssh: tower}
"""
PLACE = "place: {world: robot, upper: {gpu: true}}\n"


def read(folder: Path, more: str) -> Deployment:
    path = folder / "hosts.yaml"
    nodes = (
        'nodes: {world: {class: "a:World"}, upper: {class: "a:Upper"}}\nedges: {world -> upper: {sense: "a:seen"}}\n'
    )
    path.write_text(f"hierarchy: toys\nworld: world\n{nodes}{more}", encoding="utf-8")
    return read_deployment(path)


def test_hosts_and_places(tmp_path: Path) -> None:
    deployment = read(tmp_path, HOSTS + PLACE)
    assert deployment.hosts == {
        "robot": Host(
            "robot", ("-p", "2222", "pi@robot"), "~/venv/bin/python", "", "", {"arm": True}, "desk", lost_after_s=3
        ),
        "desk": Host("desk"),
        "tower": Host("tower", ("tower",), labels={"gpu": True, "ram_gb": 64}),
    }
    assert [host.is_here for host in deployment.hosts.values()] == [False, True, False]
    assert deployment.placed == {"world": "robot", "upper": "tower"}


def test_without_hosts_all_runs_here(tmp_path: Path) -> None:
    deployment = read(tmp_path, "")
    assert (deployment.hosts, deployment.placed) == ({}, {})


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("world: robot", "world: robt", "9: place.world: there is no host 'robt'; did you mean 'robot'?"),
        ("{world: robot", "{wrld: robot", "9: place.wrld: there is no node 'wrld'; did you mean 'world'?"),
        ("fallback: desk", "fallback: desc", "6: hosts.robot.fallback: there is no host 'desc'; did you mean 'desk'?"),
        ("desk: local", "desk: here", "7: hosts.desk: expected 'local', or a map with ssh, got 'here'"),
        ("{gpu: true}}", "{gpu: 2}}", "9: place.upper: no host has the labels {'gpu': 2}; robot has {'arm': True}; "),
        ("world: robot", "world: 7", "9: place.world: expected a host's name, or a map of labels, got 7"),
        ('"-p 2222 pi@robot"', '"-p 2222 -v"', "6: hosts.robot.ssh: expected a destination at the end, such as pi@r"),
        ('"-p 2222 pi@robot"', '"pi\'s"', "6: hosts.robot.ssh: expected what `ssh` is told, such as pi@robot, got"),
        ("lost_after: 3", "lost_after: 0", "6: hosts.robot.lost_after: expected more than 0, got 0"),
        ("python:", "pyton:", "6: hosts.robot.pyton: unknown field; did you mean 'python'?"),
        ("labels: {arm: true}", "labels: {arm: [1]}", "6: hosts.robot.labels"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, right: str, wrong: str, line: str) -> None:
    text = HOSTS + PLACE
    assert right in text
    with pytest.raises(DeploymentError) as raised:
        read(tmp_path, text.replace(right, wrong, 1))
    assert str(raised.value).startswith(f"{tmp_path / 'hosts.yaml'}:{line}")


def test_nodes_of_one_process_are_on_one_host(tmp_path: Path) -> None:
    together = "processes: {all: [world, upper]}\n"
    assert read(tmp_path, HOSTS + together + "place: {world: robot, upper: robot}\n").processes
    with pytest.raises(DeploymentError) as raised:
        read(tmp_path, HOSTS + together + PLACE)
    what = "place: process 'all' is on several hosts: world on robot, upper on tower; expected one"
    assert what in str(raised.value)
    with pytest.raises(DeploymentError, match="world on robot, upper on this machine"):
        read(tmp_path, HOSTS + together + "place: {world: robot}\n")
