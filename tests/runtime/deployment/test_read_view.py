from __future__ import annotations

from pathlib import Path

import pytest
from support.deployments import TOYS, write

from hierax.runtime.deployment.deployment import DeploymentError, ViewSpec
from hierax.runtime.deployment.read import read_deployment


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("", ViewSpec()),
        ("view:\n", ViewSpec()),
        ("view: {show: 'a.b:c'}\n", ViewSpec("a.b:c")),
        (
            "view:\n  layout:\n    - [camera, [errors, arm/belief]]\n    - [scene]\n",
            ViewSpec(None, ((("camera",), ("errors", "arm/belief")), (("scene",),))),
        ),
    ],
)
def test_how_a_deployment_is_shown(tmp_path: Path, text: str, spec: ViewSpec) -> None:
    deployment = read_deployment(write(tmp_path, TOYS + text))
    assert deployment.view == spec
    assert deployment.roster == read_deployment(write(tmp_path)).roster


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("view: {shwo: 'a:b'}\n", "shwo"),
        ("view: {show: nothing}\n", "expected 'package.module:name', got 'nothing'"),
        ("view: {layout: [camera]}\n", "view.layout"),
    ],
)
def test_a_wrong_view_is_refused(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(DeploymentError) as caught:
        read_deployment(write(tmp_path, TOYS + text))
    assert what in str(caught.value)
