"""YAML files that people write, decoded into msgspec structs; errors name file and line."""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from mavproxy_fault.documents.errors import ConfigError

T = TypeVar("T")


def read_document(path: Path) -> tuple[Any, "Lines"]:
    """Parse a YAML file into plain objects and the lines they stand on.

    Raises
    ------
    ConfigError
        If the file cannot be read or is no YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); name a YAML file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not text; a YAML file in UTF-8 is expected") from None
    try:
        node = yaml.compose(text, yaml.CSafeLoader)
        return yaml.load(text, yaml.CSafeLoader), Lines(str(path), node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or "is damaged"
        raise ConfigError(f"{where}: {problem}; valid YAML is expected") from None


def decode(document: Any, kind: type[T], lines: "Lines", at: str = "$") -> T:
    """Convert plain objects into `kind`; `at` is where they stand in the document.

    Raises
    ------
    ConfigError
        If a key or value is wrong; the text names file, line and what is allowed.
    """
    for path, value in _numbers(document, at):
        if not math.isfinite(value):
            raise ConfigError(
                f"{lines.where(path)}: {path[2:]} = {value} is not finite; a number is needed"
            )
    try:
        return msgspec.convert(document, kind)
    except msgspec.ValidationError as error:
        raise lines.error(str(error), kind, at) from None


def _numbers(document: Any, at: str) -> Iterator[tuple[str, float]]:
    """The floats in a document, each with its JSON path."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from _numbers(value, f"{at}.{key}")
    elif isinstance(document, list):
        for index, value in enumerate(document):
            yield from _numbers(value, f"{at}[{index}]")
    elif isinstance(document, float):
        yield at, document


class Lines:
    """Where each part of a parsed YAML document stands."""

    def __init__(self, name: str, node: yaml.Node | None) -> None:
        self.name = name
        self._node = node

    def where(self, path: str) -> str:
        """`file:line` of a JSON path such as `$.mission[1].shape`, or of its nearest parent."""
        node = self._node
        line = node.start_mark.line if node else 0
        for key, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", path):
            found: yaml.Node | None = None
            if isinstance(node, yaml.MappingNode):
                for name, value in node.value:
                    if name.value == key:
                        found, line = value, name.start_mark.line
            elif isinstance(node, yaml.SequenceNode) and index and int(index) < len(node.value):
                found = node.value[int(index)]
                line = found.start_mark.line
            if found is None:
                break
            node = found
        return f"{self.name}:{line + 1}"

    def error(self, text: str, kind: Any, at: str = "$") -> ConfigError:
        """Build the error from msgspec's message."""
        problem, _, place = text.partition(" - at `")
        path = place.rstrip("`") or "$"
        unknown = re.search(r"unknown field `(.+)`", problem)
        missing = re.search(r"missing required field `(.+)`", problem)
        shown = (at + path[1:])[2:]
        if unknown:
            names = ", ".join(_fields(kind, path)) or "nothing else"
            full = f"{at + path[1:]}.{unknown[1]}"
            return ConfigError(f"{self.where(full)}: {full[2:]} is unknown; known: {names}")
        if missing:
            full = f"{shown}.{missing[1]}".lstrip(".")
            return ConfigError(f"{self.where(at + path[1:])}: {full} is missing; it is required")
        problem = problem[:1].lower() + problem[1:]
        return ConfigError(
            f"{self.where(at + path[1:])}: {shown or 'the file'} is wrong; {problem}"
        )


def _fields(kind: Any, path: str) -> list[str]:
    """Names of the fields that the structs at a JSON path know."""
    kinds = [msgspec.inspect.type_info(kind)]
    for part in re.findall(r"\.([^.\[\]]+)|(\[)", path):
        following: list[msgspec.inspect.Type] = []
        for info in _spread(kinds):
            if part[0] and isinstance(info, msgspec.inspect.StructType):
                following += [f.type for f in info.fields if f.encode_name == part[0]]
            elif part[0] and isinstance(info, msgspec.inspect.DictType):
                following.append(info.value_type)
            elif not part[0] and isinstance(info, msgspec.inspect.ListType):
                following.append(info.item_type)
        kinds = following
    return [
        field.encode_name
        for info in _spread(kinds)
        if isinstance(info, msgspec.inspect.StructType)
        for field in info.fields
    ]


def _spread(kinds: list[msgspec.inspect.Type]) -> list[msgspec.inspect.Type]:
    """The members of unions beside the plain types."""
    out: list[msgspec.inspect.Type] = []
    for info in kinds:
        out += list(info.types) if isinstance(info, msgspec.inspect.UnionType) else [info]
    return out
