"""Replaces single values of a scenario by path, such as `environment.wind_ned_mps[0]=5`."""

import re
from collections.abc import Mapping
from typing import Any

import msgspec

from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document, parse_scalar
from simvehicle.scenario.scenario_file import Scenario


def change_scenario(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """The scenario with the values at some paths replaced.

    Raises
    ------
    ConfigError
        If a path does not exist, or a value is not allowed there.
    """
    if not changes:
        return scenario
    document = msgspec.to_builtins(scenario)
    for path, value in changes.items():
        document = with_value(document, path, value)
    where = ", ".join(f"{path}={value}" for path, value in changes.items())
    # Not `decode_scenario`: file names have been resolved already.
    return decode(Document(document, where, {}), Scenario)


def with_value(document: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """A copy of a scenario's document with the value at a path such as `a.b[2].c` replaced.

    Raises
    ------
    ConfigError
        If the path does not exist.
    """
    steps = re.findall(r"[^.\[\]]+", path)
    if not steps:
        raise ConfigError(f"{path!r} is not a path; write it like environment.wind_ned_mps[0]")
    changed: dict[str, Any] = _replace_at(document, steps, value, path)
    return changed


def _replace_at(node: Any, steps: list[str], value: Any, path: str) -> Any:
    key, *rest = steps
    if isinstance(node, (list, tuple)) and key.isdigit() and int(key) < len(node):
        items = list(node)
        items[int(key)] = _replace_at(items[int(key)], rest, value, path) if rest else value
        return items
    if isinstance(node, dict) and key in node:
        # Copy along the path only; the document itself stays unchanged.
        return {**node, key: _replace_at(node[key], rest, value, path) if rest else value}
    if isinstance(node, dict):
        raise ConfigError(f"{path}: {key} is unknown; known: {', '.join(node)}")
    if isinstance(node, (list, tuple)):
        raise ConfigError(f"{path}: index {key} is out of range; use 0 to {len(node) - 1}")
    raise ConfigError(f"{path}: {node!r} has no {key}; remove it from the path")


def parse_change(text: str) -> tuple[str, Any]:
    """Path and value of `PATH=VALUE`; the value is a YAML scalar.

    Raises
    ------
    ConfigError
        If there is no `=`.
    """
    path, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text}: has no =; write PATH=VALUE")
    return path.strip(), parse_scalar(value.strip())
