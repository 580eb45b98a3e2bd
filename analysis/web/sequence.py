"""Checks of the page's test sequences, also for commands to the vehicle."""

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
    """Check a sequence; returns it as a schedule file and as steps.

    Raises
    ------
    ConfigError
        If it is invalid, with all errors.
    """
    schedule = parse_schedule(read_yaml(body.decode("utf-8", "replace"), "sequence"))
    text = write_schedule(schedule.seed, [(entry, 0.0) for entry in schedule.faults])
    # Read back: the parts of a preset are one step.
    return {"yaml": text, "steps": read_yaml(text, "sequence").data["faults"]}


def refuse_commands(what: str, body: bytes) -> None:
    """Refuse commands to the vehicle; `what` is the query that would send it to the proxy.

    Raises
    ------
    ConfigError
        If it contains a command, or is not YAML.
    """
    items: Any = []
    if what.endswith("/arm"):
        # The proxy reports what cannot be decoded.
        with contextlib.suppress(msgspec.DecodeError):
            items = [msgspec.json.decode(body)]
    elif what in ("schedule/load", "schedule/begin"):
        data = read_yaml(body.decode("utf-8", "replace"), what).data
        items = data.get("faults") if isinstance(data, dict) else []
    for item in items if isinstance(items, list) else []:
        if isinstance(item, dict) and commands_vehicle(item):
            raise ConfigError(
                f"{what}: commands to the vehicle are not allowed; start the page with "
                "--allow-commands"
            )


def commands_vehicle(item: dict[str, Any]) -> bool:
    """Whether an item of a schedule file is or contains a command to the vehicle."""
    preset = str(item.get("preset"))
    parts = preset_parts(preset) if preset in preset_names() else [item]
    kinds = [fault_class(str(part.get("fault"))) for part in parts]
    return any(getattr(kind, "commands_vehicle", False) for kind in kinds)
