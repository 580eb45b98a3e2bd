"""Presets: named physical failures as YAML files with a description and schedule entries."""

from functools import cache
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.yaml_document import read_document

HERE = Path(__file__).parent


@cache
def preset_names() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    return tuple(sorted(path.stem for path in HERE.glob("*.yaml")))


@cache
def read_preset(name: str) -> dict[str, Any]:
    """Read a preset as written: `about` (one line) and `faults` (entries without times)."""
    data: dict[str, Any] = read_document(HERE / f"{name}.yaml").data
    return data


def preset_parts(name: str) -> list[dict[str, Any]]:
    """Return the entries of a preset."""
    parts: list[dict[str, Any]] = read_preset(name)["faults"]
    return parts
