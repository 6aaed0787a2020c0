"""What is said of values that the models of a deployment file refuse: which field, what was expected, what came."""

from typing import Any

from pydantic import ValidationError

from hierax.runtime.deployment.deployment import DeploymentError, Document, Keys, inside
from hierax.runtime.deployment.models import DeploymentModel, TopModel, field_meaning, field_names
from hierax.runtime.loading.arguments import in_words
from hierax.runtime.loading.nearest import did_you_mean

GONE: dict[Keys, str] = {
    ("exact",): "there is no exact staleness any more; write `delay: n` on the edges instead, which survives crashes"
}
"""Fields that once were, and what is said of them."""

_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "string_type": "text",
    "dict_type": "a map",
    "model_type": "a map",
    "model_attributes_type": "a map",
    "list_type": "a list",
    "literal_error": "{expected}",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
}


def first_error(
    error: ValidationError, document: Document, root: dict[str, Any], top: TopModel = DeploymentModel
) -> DeploymentError:
    """The fault of values that were validated by a model that comes first in the file, or in a ``--set``."""
    found = [(_keys(details["loc"], root), details) for details in error.errors(include_url=False)]
    misspelt = {keys[:-1] for keys, details in found if details["type"] == "extra_forbidden"}
    faults = [
        (document.rank(keys), index)
        for index, (keys, details) in enumerate(found)
        if details["type"] != "missing" or keys[:-1] not in misspelt  # the wrong name is the fault, not the lack
    ]
    keys, details = found[min(faults)[1]]
    return document.error(keys, _what(keys, details, top))


def _keys(loc: tuple[int | str, ...], root: dict[str, Any]) -> Keys:
    """Pydantic's path as one of the document: it may go on below a short form, or name a key."""
    keys: Keys = ()
    value: Any = root
    for key in loc:
        if key == "[key]" or not isinstance(value, (dict, list)):
            break
        keys, value = (*keys, key), inside(value, key)
    return keys


def _what(keys: Keys, details: Any, top: TopModel) -> str:
    kind = details["type"]
    context = details.get("ctx", {})
    if kind == "missing":
        return f"missing; expected {field_meaning(keys, top)}"
    if kind == "extra_forbidden" and keys in GONE:
        return GONE[keys]
    if kind == "extra_forbidden":
        return f"unknown field{did_you_mean(str(keys[-1]), field_names(keys[:-1], top))}"
    if kind == "value_error":
        return str(context["error"])
    expected = _EXPECTED.get(kind)
    if expected is None:
        return f"{details['msg']}, got {details['input']!r:.60}"
    given = "nothing" if details["input"] is None else in_words(details["input"])
    return f"expected {expected.format(**context)}, got {given}"
