"""Manifests of Kubernetes's: a Job, as a run has an end, with a volume from which another pod goes on."""

import math
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

PODS = 1000  # how many may fail
_OWN = "own"  # in each volume the folder that is this user's, which Kubernetes's own folders are not


def manifests(service: Service) -> list[Written]:
    """One file with all of them; it is secret where the deployment file is."""
    documents = [_claim(service), *_files(service), _job(service)]
    text = yaml.safe_dump_all(documents, sort_keys=False, allow_unicode=True, width=1000)
    how = f"kubectl apply -f {service.file_name}; the image is made by deploy/Containerfile"
    return [Written(service.file_name, f"{head('kubernetes', how)}{text}", service.is_secret)]


def _about(service: Service, name: str) -> dict[str, Any]:
    return {"name": name, "labels": {"app.kubernetes.io/name": service.name}}


def _claim(service: Service) -> dict[str, Any]:
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolumeClaim",
        "metadata": _about(service, f"{service.name}-state"),
        "spec": {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "1Gi"}}},
    }


def _files(service: Service) -> list[dict[str, Any]]:
    """The deployment file, where it does not come with hierax."""
    if service.is_shipped:
        return []
    kind, data = ("Secret", "stringData") if service.is_secret else ("ConfigMap", "data")
    about = _about(service, f"{service.name}-file")
    return [{"apiVersion": "v1", "kind": kind, "metadata": about, data: {service.file_name: service.text}}]


def _job(service: Service) -> dict[str, Any]:
    pod = {"metadata": {"labels": {"app.kubernetes.io/name": service.name}}, "spec": _pod(service)}
    # a pod comes when the last one is gone: two would write into one folder
    spec = {"backoffLimit": PODS, "podReplacementPolicy": "Failed", "template": pod}
    return {"apiVersion": "batch/v1", "kind": "Job", "metadata": _about(service, service.name), "spec": spec}


def _pod(service: Service) -> dict[str, Any]:
    volumes: list[dict[str, Any]] = [
        {"name": "state", "persistentVolumeClaim": {"claimName": f"{service.name}-state"}},
        {"name": "scratch", "emptyDir": {}},
        {"name": "memory", "emptyDir": {"medium": "Memory", "sizeLimit": SHARED_MEMORY}},
    ]
    if not service.is_shipped:
        of, named = ("secret", "secretName") if service.is_secret else ("configMap", "name")
        volumes.append({"name": "file", of: {named: f"{service.name}-file"}})
    return {
        "restartPolicy": "Never",  # another pod comes, which has no leftovers of this one
        "automountServiceAccountToken": False,
        "enableServiceLinks": False,
        "terminationGracePeriodSeconds": STOP_S,
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": USER,
            "runAsGroup": USER,
            "fsGroup": USER,
            "fsGroupChangePolicy": "OnRootMismatch",  # else what is private is opened to the group at each start
            "seccompProfile": {"type": "RuntimeDefault"},
        },
        "initContainers": [_folders(service)],
        "containers": [_container(service)],
        "volumes": volumes,
    }


def _folders(service: Service) -> dict[str, Any]:
    """Makes the folders that are this user's alone."""
    mounts = [{"name": name, "mountPath": f"/volumes/{name}"} for name in ("state", "scratch")]
    made = [f"{mount['mountPath']}/{_OWN}" for mount in mounts]
    return {
        "name": "folders",
        "image": service.image,
        "command": ["mkdir", "-p", "-m", "700", *made],
        "securityContext": _confined(),
        "volumeMounts": mounts,
    }


def _container(service: Service) -> dict[str, Any]:
    mounts = [
        {"name": "state", "mountPath": STATE, "subPath": _OWN},
        {"name": "scratch", "mountPath": "/tmp", "subPath": _OWN},
        {"name": "memory", "mountPath": "/dev/shm"},
    ]
    if not service.is_shipped:
        mounts.append({"name": "file", "mountPath": FOLDER})
    container: dict[str, Any] = {
        "name": "launch",
        "image": service.image,
        "args": service.in_container,
        "securityContext": _confined(),
        "volumeMounts": mounts,
        "startupProbe": _probe(service, "0", math.ceil(service.start_s / LOOK_S) + 1),
        "readinessProbe": _probe(service, "10", 1),
        "livenessProbe": _probe(service, "0", 3),
    }
    if service.cores is not None:
        container["resources"] = {"requests": {"cpu": f"{math.ceil(round(service.cores * 1000, 3))}m"}}
    return container


def _probe(service: Service, within_s: str, failures: int) -> dict[str, Any]:
    return {
        "exec": {"command": ["hierax", *service.health("--within", within_s)]},
        "periodSeconds": LOOK_S,
        "timeoutSeconds": ANSWER_S,
        "failureThreshold": failures,
    }


def _confined() -> dict[str, Any]:
    return {
        "readOnlyRootFilesystem": True,
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
    }
