"""YAML files of settings, read strictly: no code, no repeated keys, no merged keys, bounded size."""

import reprlib
from pathlib import Path
from typing import Any

import yaml

from planspace.errors import PlanspaceError
from planspace.storage.files import read_bytes

MAX_FILE_BYTES = 1 << 17
"""PyYAML takes seconds for a file of this size, for any content."""
MAX_TEXT = 4096
"""Characters of a key or a value: enough for a path. PyYAML is slow for long numbers with colons."""
MAX_SHOWN = 80
"""Characters of a value in a message."""
BYTES = "<byte string>"
"""PyYAML's name of a text that it did not open itself."""
MERGE_TAG = "tag:yaml.org,2002:merge"


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a file of keys and values.

    Raises:
        PlanspaceError: the file cannot be read, is not valid YAML, or does not hold keys and values.
    """
    data = read_bytes(path, most=MAX_FILE_BYTES, may_be_link=True)
    try:
        settings = yaml.load(data, Loader=StrictLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        problem = " ".join(str(error).replace(f'in "{BYTES}", ', "at ").split())
        raise PlanspaceError(f"{path} is not valid YAML: {problem}") from error
    if settings is None:
        raise PlanspaceError(f"{path} is empty; it must hold keys and values.")
    if not isinstance(settings, dict):
        raise PlanspaceError(f"{path} must hold keys and values, got a {type(settings).__name__}.")
    if not all(isinstance(key, str) for key in settings):
        raise PlanspaceError(f"{path} must have names as keys, got {short(list(settings))}.")
    return settings


class StrictLoader(yaml.SafeLoader):
    """YAML's safe loader, which also refuses repeated keys, merged keys and very long text."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse a repeated key, and a merge key, which can stand for any number of keys."""
        keys: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE_TAG:
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be plain text", key.start_mark
                )
            if key.value in keys:
                raise yaml.constructor.ConstructorError(None, None, f"the key {key.value!r} comes twice")
            keys.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        """Refuse a text that is too long, before it is read as a number."""
        if len(node.value) > MAX_TEXT:
            problem = f"a text has {len(node.value)} characters; the limit is {MAX_TEXT}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return super().construct_scalar(node)


def short(value: Any) -> str:
    """A value for a message, shortened: with YAML's aliases, a small file can hold a huge value."""
    return reprlib.repr(value)[:MAX_SHOWN]
