"""What of Zenoh's settings is secret, and leaves the processes of a launch nowhere: passwords and private keys.

It is in no file that hierax writes, in no recording, and in no answer. Of a ``--set`` that
gives something secret the path alone is kept, without ``=``."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hierax.runtime.core.errors import HieraxError

if TYPE_CHECKING:
    import yaml

HIDDEN = "(not stored)"  # what stands for something secret in a text

_SECRET = re.compile(
    r"\w*(password|passwd|passphrase|secret|credential|token|private_key_(pem|base64))(?!\w*_(file|path)\b)\w*", re.I
)
_VALUE = r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|[^\s,;}"']+)"""
_IN_TEXT = re.compile(rf"""(["']?{_SECRET.pattern}["']?\s*[:=]\s*){_VALUE}""", re.I)
_ANCHOR = re.compile(r"&\S+\s+")
_SURE_CHARS = 4  # shorter secrets may be part of other words by chance


def is_secret(name: str) -> bool:
    """Whether a field of this name holds something secret, and not the path of a file with it."""
    return _SECRET.fullmatch(name) is not None


def secret_values(zenoh: Any) -> frozenset[str]:
    """What is secret in Zenoh's settings: a map, JSON5 text, the path of a file, or None."""
    return frozenset(found for found in _values(zenoh) if found)


def public_settings(settings: Sequence[str], zenoh: Any) -> tuple[str, ...]:
    """Settings (``--set``) as they may be kept: of one that gives something secret to Zenoh, the path alone."""
    secrets = secret_values(zenoh)
    return tuple(text.partition("=")[0].strip() if _is_hidden(text, secrets) else text for text in settings)


def public_setting(text: str) -> str:
    """A setting as errors show it."""
    return f"{text.partition('=')[0]}=…" if _is_hidden(text, frozenset()) else text


def usable(settings: Sequence[str]) -> list[str]:
    """Those of the kept settings whose values are kept, too."""
    return [text for text in settings if "=" in text]


def completed(kept: Sequence[str], given: Sequence[str]) -> list[str]:
    """Kept settings, and what was not kept given again; `HieraxError` if one lacks, or is given that was kept."""
    again = {text.partition("=")[0].strip(): text for text in given}
    hidden = [text for text in kept if "=" not in text]
    lacking = [path for path in hidden if path not in again]
    if lacking:
        what = f"what --set {lacking[0]} gave is secret and was not stored"
        raise HieraxError(f"{what}; give it again: --set {lacking[0]}=VALUE")
    other = [path for path in again if path not in hidden]
    if other:
        raise HieraxError(f"--set {other[0]}: the run knows its settings; only secret ones are given again")
    return [again.get(text, text) for text in kept]


def public_text(text: str, zenoh: Any) -> str:
    """The text of a deployment file, YAML that was read, without what is secret in Zenoh's settings that it led to."""
    secrets = secret_values(zenoh)
    if not secrets:
        return text
    spans = sorted({(each.start_mark.index, each.end_mark.index) for each in _secret_scalars(text, secrets)})
    for start, end in reversed(spans):
        anchor = _ANCHOR.match(text, start, end)
        line_end = "\n" if text[start:end].endswith("\n") else ""
        text = f'{text[:start]}{anchor[0] if anchor else ""}"{HIDDEN}"{line_end}{text[end:]}'
    for secret in secrets:  # in comments, or in other words for the same
        if len(secret) > _SURE_CHARS:
            text = text.replace(secret, HIDDEN)
    return text


def _secret_scalars(text: str, secrets: frozenset[str]) -> "Iterator[yaml.ScalarNode]":
    """What is secret in the settings of Zenoh, and in the parameters that they may come from."""
    import yaml  # nodes' processes, which read no deployment file, do without it

    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(root, yaml.MappingNode):
        return
    for key, value in root.value:
        if key.value in ("zenoh", "parameters"):
            for scalar in _scalars(value, set()):
                if _has_secret(scalar.value, secrets, 0 if key.value == "zenoh" else _SURE_CHARS):
                    yield scalar


def _has_secret(text: str, secrets: frozenset[str], sure_chars: int = _SURE_CHARS) -> bool:
    return any(secret == text or (len(secret) >= sure_chars and secret in text) for secret in secrets)


def _scalars(node: "yaml.Node", seen: set[int]) -> "Iterator[yaml.ScalarNode]":
    import yaml

    if id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.ScalarNode):
        yield node
    elif isinstance(node, yaml.CollectionNode):
        for part in node.value:
            yield from _scalars(part[1] if isinstance(node, yaml.MappingNode) else part, seen)


def _is_hidden(text: str, secrets: frozenset[str]) -> bool:
    path, equals, value = text.partition("=")
    value = value.strip().strip("\"'")
    if not equals:
        return False
    names = path.strip().split(".")
    if names[0] == "zenoh" and (any(map(is_secret, names)) or _IN_TEXT.search(value)):
        return True
    return _has_secret(value, secrets)


def _values(zenoh: Any, inside: bool = False) -> Iterator[str]:
    """What is secret in settings; `inside` of what is secret, all of it."""
    if isinstance(zenoh, Mapping):
        for name, value in zenoh.items():
            yield from _values(value, inside or is_secret(str(name)))
    elif isinstance(zenoh, (list, tuple)):
        for value in zenoh:
            yield from _values(value, inside)
    elif inside and zenoh is not None:
        yield str(zenoh)
    elif isinstance(zenoh, str):
        yield from (found[len(found.groups())].strip("\"'") for found in _IN_TEXT.finditer(zenoh))
