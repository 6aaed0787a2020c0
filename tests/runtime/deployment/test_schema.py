from __future__ import annotations

import json
import re

from hierax.runtime.deployment.models import field_names
from hierax.runtime.deployment.schema import SCHEMA_FILE, deployment_schema, schema_text


def test_the_published_schema_is_up_to_date() -> None:
    again = "python -m hierax.runtime.deployment.schema > runtime/deployment/deployment.schema.json"
    published = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))
    assert published == json.loads(schema_text()), f"write it again: {again}"


def test_it_has_every_field() -> None:
    schema = deployment_schema()
    assert tuple(schema["properties"]) == field_names(())
    assert tuple(schema["$defs"]["NodeModel"]["properties"]) == field_names(("nodes", "world"))
    assert tuple(schema["$defs"]["RestartModel"]["properties"]) == field_names(("restart",))
    assert tuple(schema["$defs"]["EdgeModel"]["properties"]) == field_names(("edges", "a -> b"))
    assert tuple(schema["$defs"]["FunctionModel"]["properties"]) == field_names(("edges", "a -> b", "sense"))
    assert tuple(schema["$defs"]["ProbeModel"]["properties"]) == field_names(("probes", 0))
    assert all(
        part["additionalProperties"] is False for part in (schema, *schema["$defs"].values()) if "properties" in part
    )


def test_a_reference_may_stand_for_a_number() -> None:
    schema = deployment_schema()
    assert {"$ref": "#/$defs/Reference"} in schema["properties"]["epochs"]["anyOf"]
    pattern = schema["$defs"]["Reference"]["pattern"]
    assert re.search(pattern, "${noise}")
    assert not re.search(pattern, "noise")


def test_a_reference_may_stand_for_a_choice_and_in_a_list() -> None:
    schema = deployment_schema()
    reference = {"$ref": "#/$defs/Reference"}
    assert reference in schema["properties"]["durability"]["anyOf"]
    assert reference in schema["$defs"]["RestartModel"]["properties"]["on_loss"]["anyOf"]
    modules = schema["properties"]["modules"]["anyOf"][0]["anyOf"][0]
    assert reference in modules["items"]["anyOf"]


def test_the_defaults_of_restarts_are_those_of_all_nodes() -> None:
    schema = deployment_schema()
    for name in field_names(("restart",)):
        assert "default" in schema["$defs"]["RestartModel"]["properties"][name]
        assert "default" not in schema["$defs"]["NodeModel"]["properties"][name]


def test_names_are_closed() -> None:
    nodes = deployment_schema()["properties"]["nodes"]
    (pattern,) = nodes["patternProperties"]
    assert nodes["additionalProperties"] is False
    assert re.search(pattern, "top.most")
    assert not re.search(pattern, "wor ld")
