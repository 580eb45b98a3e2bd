"""Test sequences of the page: checked, and refused where they command the vehicle."""

import contextlib
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_yaml
from mavproxy_fault.faults.registry import fault_class
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.schedule.presets import preset_names, preset_parts
from mavproxy_fault.schedule.saving import write_schedule


def check_sequence(body: bytes) -> dict[str, Any]:
    """A sequence as a schedule file, and as the data of its steps.

    Raises
    ------
    ConfigError
        With every error of it.
    """
    schedule = parse_schedule(read_yaml(body.decode("utf-8", "replace"), "sequence"))
    text = write_schedule(schedule.seed, [(entry, 0.0) for entry in schedule.faults])
    # Read back: the parts of a preset are one step.
    return {"yaml": text, "steps": read_yaml(text, "sequence").data["faults"]}


def refuse_commands(what: str, body: bytes) -> None:
    """Refuse what commands the vehicle: `what` is the query that would carry it to the proxy.

    Raises
    ------
    ConfigError
        If it does, or is no YAML.
    """
    listed: Any = []
    if what.endswith("/arm"):
        # What cannot be read, the proxy explains.
        with contextlib.suppress(msgspec.DecodeError):
            listed = [msgspec.json.decode(body)]
    elif what in ("schedule/load", "schedule/begin"):
        data = read_yaml(body.decode("utf-8", "replace"), what).data
        listed = data.get("faults") if isinstance(data, dict) else []
    for item in listed if isinstance(listed, list) else []:
        if isinstance(item, dict) and commands_vehicle(item):
            raise ConfigError(
                f"{what}: commands the vehicle, which this page does not do; start it with "
                "--allow-commands"
            )


def commands_vehicle(item: dict[str, Any]) -> bool:
    """Whether an item of a schedule, as written, is or holds a command to the vehicle."""
    preset = str(item.get("preset"))
    parts = preset_parts(preset) if preset in preset_names() else [item]
    kinds = [fault_class(str(part.get("fault"))) for part in parts]
    return any(getattr(kind, "commands_vehicle", False) for kind in kinds)
