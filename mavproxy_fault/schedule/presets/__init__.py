"""Named faults of the field as YAML files: one line about it, and entries of a schedule."""

from functools import cache
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent


@cache
def preset_names() -> tuple[str, ...]:
    """The names of all presets, sorted."""
    return tuple(sorted(path.stem for path in HERE.glob("*.yaml")))


@cache
def read_preset(name: str) -> dict[str, Any]:
    """A preset as written: `about` (one line) and `faults` (entries without times)."""
    text = (HERE / f"{name}.yaml").read_text(encoding="utf-8")
    data: dict[str, Any] = yaml.load(text, yaml.CSafeLoader)
    return data


def preset_parts(name: str) -> list[dict[str, Any]]:
    """The entries of a preset."""
    parts: list[dict[str, Any]] = read_preset(name)["faults"]
    return parts
