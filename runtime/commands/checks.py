"""What several commands see to before they do something with a deployment."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hierax.runtime.core.hierarchy import Hierarchy
    from hierax.runtime.deployment import Deployment


def check_zenoh(deployment: "Deployment") -> None:
    """Raises `HieraxError`, with the place in the file, where Zenoh would refuse the settings there."""
    if deployment.zenoh is None:
        return
    from hierax.runtime.transport.port import TransportError
    from hierax.runtime.transport.zenoh_session import check_settings

    try:
        check_settings(deployment.zenoh, deployment.low_latency)
    except TransportError as error:
        raise deployment.document.error(("zenoh",), str(error)) from error


@contextmanager
def made(deployment: "Deployment") -> Iterator["Hierarchy"]:
    """The hierarchy of a deployment as it is set, for the block; faults in it have their place in the file. Raises
    `HieraxError` where Zenoh refuses its settings, or a node or function cannot be made."""
    from hierax.runtime.core.binding import OperatorSetting
    from hierax.runtime.loading.loader import build_hierarchy, extend_import_path
    from hierax.runtime.loading.node_loader import wait_for

    check_zenoh(deployment)
    extend_import_path(deployment.import_paths)
    with deployment.explaining(), redirect_stdout(sys.stderr):  # what a node prints must not mix with the result
        yield build_hierarchy(deployment.roster, OperatorSetting(wait=wait_for), deployment.allowance)
