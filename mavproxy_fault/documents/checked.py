"""YAML read with its line numbers, and turned into typed structs with all errors, not the first."""

import re
import types
import typing
from collections.abc import Iterable
from typing import Any

import msgspec
import yaml

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import near

Path = tuple[str | int, ...]
Lines = dict[Path, int]


class _Loader(yaml.CSafeLoader):
    """PyYAML follows YAML 1.1, where 1e-3 is text; YAML 1.2 and people read a number."""


_Loader.yaml_implicit_resolvers = {
    key: list(resolvers) for key, resolvers in yaml.CSafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d[\d_]*)(\.\d*)?[eE][-+]?\d+|[-+]?\.\d+[eE][-+]?\d+"),
    list("-+.0123456789"),
)


def read_yaml(text: str, where: str) -> tuple[Any, Lines]:
    """The data of a YAML text and the line on which each key or item stands.

    Raises
    ------
    ConfigError
        If the text is no YAML, or a key stands twice.
    """
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        lines: Lines = {}
        doubles: list[str] = []
        if node is not None:
            _number(node, (), lines, doubles)
        if doubles:
            raise ConfigError("\n".join(f"{where}:{double}" for double in doubles))
        return (loader.construct_document(node) if node is not None else None), lines
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error)
        raise ConfigError(f"{where}{line}: not YAML: {problem}; see yaml.org") from None


def _number(node: yaml.Node, path: Path, lines: Lines, doubles: list[str]) -> None:
    lines.setdefault(path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*path, key.value)
            line = key.start_mark.line + 1
            if inner in lines:
                doubles.append(f"{line}: {key.value} stands twice; give each key once")
            lines[inner] = line
            _number(value, inner, lines, doubles)
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(node.value):
            _number(value, (*path, i), lines, doubles)


def spelled(path: Path) -> str:
    """A path as a person writes it: faults[3].profile.segments[0].rate."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


class Check:
    """Gathers every error of one file while its parts are converted."""

    def __init__(self, where: str, lines: Lines | None = None) -> None:
        self.where = where
        self.lines = lines or {}
        self.via = "proxy"  # where satellite faults act that do not say
        self.errors: list[tuple[int, str]] = []

    def wrong(self, path: Path, text: str) -> None:
        """Note an error at the nearest line known."""
        line = next((self.lines[path[:n]] for n in range(len(path), -1, -1)
                     if path[:n] in self.lines), 0)  # fmt: skip
        place = f"{self.where}:{line}" if line else self.where
        self.errors.append((line, f"{place}: {spelled(path)}{' ' if path else ''}{text}"))

    def finish(self) -> None:
        """Raise all errors, in the order of their lines.

        Raises
        ------
        ConfigError
            If there are any.
        """
        if self.errors:
            in_order = sorted(self.errors, key=lambda error: error[0])
            raise ConfigError("\n".join(text for _, text in in_order))

    def keys(self, data: dict[Any, Any], known: Iterable[str], path: Path) -> None:
        """Note every key that is not known."""
        names = list(known)
        for key in data:
            if key not in names:
                self.wrong((*path, str(key)), f"is unknown; {near(str(key), names)}")

    def value(self, data: Any, kind: Any, path: Path) -> Any:
        """One value converted to a type; None with the errors noted if it does not fit."""
        struct = _struct_in(kind, data)
        if struct is not None:
            return self.struct(data, struct, path)
        item = _item_in(kind, data)
        if item is not None:
            return tuple(self.value(one, item, (*path, i)) for i, one in enumerate(data))
        try:
            return msgspec.convert(data, kind)
        except msgspec.ValidationError as error:
            text = str(error).split(" - at `$")[0]
            self.wrong(path, f"= {data!r} does not fit: {text[0].lower()}{text[1:]}")
            return None

    def arguments(
        self, data: dict[str, Any], kind: type[msgspec.Struct], path: Path, given: Iterable[str]
    ) -> dict[str, Any]:
        """The struct's fields found in `data`, converted; those `given` are left to the caller."""
        hints = typing.get_type_hints(kind, include_extras=True)
        found: dict[str, Any] = {}
        for field in msgspec.structs.fields(kind):
            if field.name in given:
                continue
            if field.name in data:
                here = (*path, field.name)
                found[field.name] = self.value(data[field.name], hints[field.name], here)
            elif field.required:
                self.wrong(path, f"lacks {field.name}; it must be given")
        return found

    def struct(self, data: Any, kind: type[msgspec.Struct], path: Path) -> Any:
        """A whole struct; None with the errors noted if it is wrong."""
        if not isinstance(data, dict):
            self.wrong(path, f"= {data!r} does not fit: expected keys and values")
            return None
        before = len(self.errors)
        self.keys(data, (field.name for field in msgspec.structs.fields(kind)), path)
        found = self.arguments(data, kind, path, ())
        if len(self.errors) > before:
            return None
        try:
            return kind(**found)
        except ValueError as error:
            self.wrong(path, str(error))
            return None


def _choices(kind: Any) -> tuple[Any, ...]:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return typing.get_args(kind)
    return (kind,)


def _struct_in(kind: Any, data: Any) -> type[msgspec.Struct] | None:
    """The struct that a mapping is meant to become."""
    if not isinstance(data, dict):
        return None
    for choice in _choices(kind):
        if isinstance(choice, type) and issubclass(choice, msgspec.Struct):
            return choice
    return None


def _item_in(kind: Any, data: Any) -> Any:
    """The type of the items, where a list is meant to become a tuple of structs."""
    if not isinstance(data, list):
        return None
    for choice in _choices(kind):
        if typing.get_origin(choice) is tuple and typing.get_args(choice)[1:] == (...,):
            inner = typing.get_args(choice)[0]
            if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
                return inner
    return None
