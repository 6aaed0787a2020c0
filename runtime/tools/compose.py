"""A Compose file, for docker or podman: one container that runs the launch."""

from typing import Any

import yaml

from hierax.runtime.tools.services import (
    ANSWER_S,
    FOLDER,
    LOOK_S,
    SHARED_MEMORY,
    STATE,
    STOP_S,
    USER,
    Service,
    Written,
    head,
)


def compose(service: Service) -> list[Written]:
    """`compose.yaml`, and the deployment file beside it, where that does not come with hierax."""
    document: dict[str, Any] = {
        "name": service.name,
        "services": {service.name: _container(service)},
        "volumes": {"state": {}},
    }
    files = []
    if not service.is_shipped:
        kind = "secrets" if service.is_secret else "configs"
        document[kind] = {"deployment": {"file": f"./{service.file_name}"}}
        files = [Written(service.file_name, service.text, service.is_secret)]
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=1000)
    how = "docker compose up --detach; the image is made by deploy/Containerfile"
    return [Written("compose.yaml", f"{head('compose', how)}{text}"), *files]


def _container(service: Service) -> dict[str, Any]:
    container: dict[str, Any] = {
        "image": service.image,
        "command": [argument.replace("$", "$$") for argument in service.in_container],
        "user": f"{USER}:{USER}",
        "init": True,
        "read_only": True,
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
        "tmpfs": ["/tmp:mode=1777"],
        "shm_size": SHARED_MEMORY.removesuffix("i").lower(),
        "volumes": [f"state:{STATE}"],
        "restart": "on-failure",
        "stop_grace_period": f"{STOP_S}s",
        "healthcheck": {
            "test": ["CMD", "hierax", *service.health()],
            "interval": f"{LOOK_S}s",
            "timeout": f"{ANSWER_S}s",
            "start_period": f"{service.start_s}s",
            "retries": 3,
        },
    }
    if not service.is_shipped:
        kind = "secrets" if service.is_secret else "configs"
        container[kind] = [{"source": "deployment", "target": f"{FOLDER}/{service.file_name}"}]
    if service.priority:
        container["ulimits"] = {"rtprio": service.priority}
    if service.cores is not None:
        container["deploy"] = {"resources": {"reservations": {"cpus": f"{service.cores:.3f}"}}}
    return container
