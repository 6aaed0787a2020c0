"""Values as the YAML that `hierax.runtime.deployment.tree` reads back, which is another one than PyYAML writes: to that
``1e5`` is a text."""

import math
from typing import Any

import numpy as np
import yaml

from hierax.runtime.deployment.tree import RESOLVERS


class _Dumper(yaml.SafeDumper):
    """Quotes what either YAML would take for something else than a text."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - the base class's name
        first: [*yaml.SafeDumper.yaml_implicit_resolvers.get(first, ()), *RESOLVERS.get(first, ())]
        for first in {*yaml.SafeDumper.yaml_implicit_resolvers, *RESOLVERS}
    }

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_multi_representer(int, lambda dumper, value: dumper.represent_int(int(value)))
_Dumper.add_multi_representer(float, lambda dumper, value: dumper.represent_float(float(value)))
_Dumper.add_multi_representer(str, lambda dumper, value: dumper.represent_str(str.__str__(value)))
_OF_NUMPY: tuple[Any, ...] = (np.generic, np.ndarray)
for _kind in _OF_NUMPY:
    _Dumper.add_multi_representer(_kind, lambda dumper, value: dumper.represent_data(value.tolist()))


def yaml_of(value: Any) -> str:
    """A value as YAML. Raises `yaml.YAMLError` if something in it is neither text, number, list, map nor array."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120))


def yaml_line_of(value: Any) -> str:
    """The same in one line."""
    text = str(yaml.dump(value, Dumper=_Dumper, default_flow_style=True, allow_unicode=True, width=math.inf))
    return text.removesuffix("...\n").strip()
