"""The published JSON Schema of the deployment file, for editors.

``python -m hierax.runtime.deployment.schema`` prints it; it is kept beside this module."""

import json
import sys
from pathlib import Path
from typing import Any

from hierax.runtime.deployment.models import DeploymentModel, field_names

SCHEMA_FILE = Path(__file__).with_name("deployment.schema.json")

_REFERENCE = {
    "type": "string",
    "pattern": r"\$\{[A-Za-z_][A-Za-z0-9_-]*\}",
    "description": "${NAME} stands for the parameter of that name",
}
_LITERAL = ("parameters", "nodes", "edges", "probes")  # fields of the whole file that cannot be a ``${NAME}``


def deployment_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a deployment file, before ``${NAME}`` is replaced."""
    schema = DeploymentModel.model_json_schema(mode="validation")
    for definition in (schema, *schema["$defs"].values()):
        literal = _LITERAL if definition is schema else ()
        properties = definition["properties"]
        for name, value in properties.items():
            _close(value)
            if name not in literal:
                properties[name] = _or_reference(value)
    for name in field_names(("restart",)):  # of a node, it is what `restart` at the top says
        del schema["$defs"]["NodeModel"]["properties"][name]["default"]
    schema["$defs"]["Reference"] = _REFERENCE
    schema["title"] = "hierax deployment"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def schema_text() -> str:
    return json.dumps(deployment_schema(), indent=2) + "\n"


def _close(value: dict[str, Any]) -> None:
    """Let a map have no other names than its pattern says, a list references; leave out what is the default anyway."""
    for part in (value, *value.get("anyOf", ())):
        if "pattern" in part.get("items", ()):
            part["items"] = _or_reference(part["items"])
        if part.get("additionalProperties") is True:
            del part["additionalProperties"]
        if "patternProperties" in part:
            part["additionalProperties"] = False


def _or_reference(value: dict[str, Any]) -> dict[str, Any]:
    """A field's schema that also lets a ``${NAME}`` stand for the value."""
    if value.get("type") == "string" and not value.keys() & {"pattern", "enum"}:
        return value
    rest = {key: part for key, part in value.items() if key not in ("default", "description")}
    kinds = rest["anyOf"] if set(rest) == {"anyOf"} else [rest]
    about = {key: part for key, part in value.items() if key in ("default", "description")}
    return {**about, "anyOf": [*kinds, {"$ref": "#/$defs/Reference"}]}


if __name__ == "__main__":
    sys.stdout.write(schema_text())
