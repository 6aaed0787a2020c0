"""What is written for systemd, Compose and Kubernetes is what those take."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from hierax.runtime.core.errors import HieraxError
from hierax.runtime.deployment.read import read_deployment
from hierax.runtime.tools.compose import compose
from hierax.runtime.tools.kubernetes import manifests
from hierax.runtime.tools.services import Service, check_settings
from hierax.runtime.tools.systemd import units

ROOT = Path(__file__).parents[3]
OWN = """\
hierarchy: Robot_1
world: world
zenoh: {zenoh}
nodes:
  world: {{class: "hierax.nodes.servo:SlidingWorld", rate_hz: 20, budget_ms: 10}}
  camera: {{class: "hierax.nodes.servo:CameraNode", budget_ms: 20, scheduling: {{policy: fifo, priority: 40}}}}
  motion: {{class: "hierax.nodes.servo:MotionNode"}}
edges:
  world -> camera: {{sense: "hierax.nodes.servo:MeasuredPosition"}}
  camera -> motion: {{sense: "hierax.nodes.servo:position"}}
"""
SECRET = "{transport: {auth: {usrpwd: {user: me, password: hidden-word}}}}"


def own(folder: Path, zenoh: str = "null", *settings: str) -> Service:
    path = folder / "my robot.yaml"
    path.write_text(OWN.format(zenoh=zenoh), encoding="utf-8")
    return Service(read_deployment(str(path), settings), settings, seed=7, epochs=9)


@pytest.fixture(params=["shipped", "own", "secret"])
def service(request: pytest.FixtureRequest, tmp_path: Path) -> Service:
    if request.param == "shipped":
        return Service(read_deployment("servo"), ("noise=0.2",))
    return own(tmp_path, SECRET if request.param == "secret" else "null")


def container_of(service: Service) -> dict[str, Any]:
    document = yaml.safe_load(compose(service)[0].text)
    return dict(document["services"][service.name])


def job_of(service: Service) -> dict[str, Any]:
    (job,) = (each for each in yaml.safe_load_all(manifests(service)[0].text) if each["kind"] == "Job")
    return dict(job["spec"]["template"]["spec"])


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_takes_the_units(service: Service, tmp_path: Path) -> None:
    written = units(service)
    for each in written:
        (tmp_path / each.name).write_text(each.text, encoding="utf-8")
    (tmp_path / "run").mkdir(mode=0o700)
    done = subprocess.run(
        ["systemd-analyze", "--user", "verify", *(tmp_path / each.name for each in written)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path / "run")},
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_units_work_where_they_were_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters name files relative to where a command runs, and were accepted there."""
    (here := tmp_path / "50 % here").mkdir()
    monkeypatch.chdir(here)
    where = f"WorkingDirectory={tmp_path}/50 %% here\n"
    for service in (own(tmp_path), Service(read_deployment("servo"), ("noise=0.2",))):
        assert where in units(service)[0].text
    assert "WorkingDirectory=%S/hierax-servo\n" in units(Service(read_deployment("servo")))[0].text


def test_compose_takes_the_file(service: Service) -> None:
    spec = pytest.importorskip("compose_spec")
    assert spec.PyCompose.from_yaml(compose(service)[0].text).service_names() == [service.name]


@pytest.mark.parametrize("version", ["1.30", "1.34", "1.37"])
def test_kubernetes_takes_the_manifests(service: Service, version: str) -> None:
    published = pytest.importorskip("kubernetes_validate")
    kinds = []
    for document in yaml.safe_load_all(manifests(service)[0].text):
        published.validate(document, version, strict=True)
        kinds.append(document["kind"])
    file = [] if service.is_shipped else ["Secret" if service.is_secret else "ConfigMap"]
    assert kinds == ["PersistentVolumeClaim", *file, "Job"]


def test_containers_run_as_nobody_and_write_to_volumes_alone(service: Service) -> None:
    image = (ROOT / "deploy" / "Containerfile").read_text(encoding="utf-8")
    assert "\nUSER 10001:10001\n" in image
    container = container_of(service)
    assert (container["read_only"], container["user"], container["cap_drop"]) == (True, "10001:10001", ["ALL"])
    pod = job_of(service)
    assert pod["securityContext"]["runAsNonRoot"]
    for each in pod["initContainers"] + pod["containers"]:
        assert each["securityContext"]["readOnlyRootFilesystem"]
        assert each["securityContext"]["capabilities"] == {"drop": ["ALL"]}


def test_budgets_ask_for_cores(tmp_path: Path) -> None:
    robot = own(tmp_path)
    assert robot.cores == pytest.approx(20 * (0.010 + 0.020))
    assert job_of(robot)["containers"][0]["resources"] == {"requests": {"cpu": "600m"}}
    assert container_of(robot)["deploy"]["resources"]["reservations"] == {"cpus": "0.600"}
    assert "resources" not in job_of(Service(read_deployment("servo")))["containers"][0]


def test_who_takes_part_in_few_epochs_asks_for_its_share(tmp_path: Path) -> None:
    robot = own(tmp_path, "null", "nodes.camera.every=5", "nodes.motion.every=60", "nodes.motion.budget_ms=300")
    assert robot.cores == pytest.approx(20 * (0.010 + 0.020 / 5 + 0.300 / 60))


def test_a_real_time_priority_is_allowed(tmp_path: Path) -> None:
    assert "LimitRTPRIO=40" in units(own(tmp_path))[0].text
    assert container_of(own(tmp_path))["ulimits"] == {"rtprio": 40}


def test_what_is_secret_stands_in_files_for_their_user_alone(tmp_path: Path) -> None:
    robot = own(tmp_path, SECRET)
    for written in (*units(robot), *compose(robot), *manifests(robot)):
        assert written.is_secret == ("hidden-word" in written.text), written.name
    with pytest.raises(HieraxError, match=r"--set zenoh.*secret"):
        check_settings(robot.deployment, ["zenoh.transport.auth.usrpwd.password=hidden-word"])


def test_settings_in_another_file_do_not_come_along(tmp_path: Path) -> None:
    (tmp_path / "zenoh.json5").write_text("{}", encoding="utf-8")
    with pytest.raises(HieraxError, match=r"zenoh\.json5 is a file of this machine"):
        compose(own(tmp_path, "zenoh.json5"))


def test_hosts_are_reached_by_units_and_not_from_containers(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    hosts = "hosts: {robot: {ssh: pi@robot}, desk: local}\nplace: {world: robot, camera: desk}\n"
    path.write_text(OWN.format(zenoh="null") + hosts, encoding="utf-8")
    robot = Service(read_deployment(str(path)))
    for written in (compose, manifests):
        with pytest.raises(HieraxError, match=r"robot.yaml: node world runs on host robot, which ssh reaches"):
            written(robot)
    assert units(robot)
    at_desk = Service(read_deployment(str(path), ("place.world=desk",)))
    assert compose(at_desk)


def test_odd_words_stay_as_they_are(tmp_path: Path) -> None:
    setting = """nodes.world.parameters={"a": "100% $HOME \\\\ 'b'"}"""
    robot = Service(own(tmp_path).deployment, (setting,))
    (command,) = (line for line in units(robot)[0].text.splitlines() if line.startswith("ExecStart="))
    assert "100%% $$HOME" in command
    assert container_of(robot)["command"][-1] == setting.replace("$", "$$")
    assert job_of(robot)["containers"][0]["args"][-1] == setting
