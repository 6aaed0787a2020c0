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


def test_names_are_closed() -> None:
    nodes = deployment_schema()["properties"]["nodes"]
    (pattern,) = nodes["patternProperties"]
    assert nodes["additionalProperties"] is False
    assert re.search(pattern, "top.most")
    assert not re.search(pattern, "wor ld")
