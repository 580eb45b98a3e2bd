"""`mavproxy-fault faults`: list faults and presets; check and plot schedules."""

import argparse
import inspect
import json
from pathlib import Path
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.faults.registry import (
    acts_on_ranges,
    fault_class,
    known_aliases,
    known_faults,
)
from mavproxy_fault.schedule.binding import TARGET_FIELDS
from mavproxy_fault.schedule.entries import Entry, EntryKeys, parse_schedule, read_schedule
from mavproxy_fault.schedule.presets import preset_names, read_preset
from mavproxy_fault.wire.dialect import built_in_messages, message_layout, message_names
from mavproxy_fault.wire.dialect_files import dialect_paths

TARGETS = {
    "fields": "MESSAGE.field, MESSAGE.field[3] or a list of them",
    "frames": "MESSAGE or a list of them (all messages if not given)",
    "satellites": "PSEUDORANGE.G12 or a list of them",
    "plant": "PLANT.parameter or a list of them",
}


def main(args: argparse.Namespace) -> int:
    """Run one of the actions."""
    if args.action == "list":
        print(list_messages() if args.messages else list_catalogue())
    elif args.action == "show":
        print(describe_fault(args.name))
    elif args.action == "check":
        schedule = read_schedule(args.file)
        plural = "s" * (len(schedule.faults) != 1)
        print(f"{args.file}: {len(schedule.faults)} fault{plural}: OK")
        for entry in schedule.faults:
            print(f"  {entry.id}: {describe_entry(entry)}")
    elif args.action == "plot":
        _plot(args)
    else:
        print(json.dumps(schedule_schema(), indent=2))
    return 0


def list_messages() -> str:
    """List the messages that may be targets, with their ids, one per line, after their sources."""
    sources = [
        "built in: " + " ".join(text for key, text in one.items() if key != "sha256")
        for one in built_in_messages()["sources"]
    ] + [f"dialect: {path}" for path in dialect_paths()]
    layouts = sorted((message_layout(name) for name in message_names()), key=lambda one: one.id)
    return "\n".join([*sources, *(f"{layout.id:8}  {layout.name}" for layout in layouts)])


def list_catalogue() -> str:
    """List all faults and presets, one per line."""
    rows = [("faults", "")]
    for name, kind in known_faults().items():
        aliases = ", ".join(getattr(kind, "aliases", ()))
        also = f" (also {aliases})" if aliases else ""
        rows.append((f"  {name}", first_line(kind) + also))
    rows.append(("presets", ""))
    rows += [(f"  {name}", str(read_preset(name)["about"])) for name in preset_names()]
    return "\n".join(f"{left:28}{right}".rstrip() for left, right in rows)


def first_line(kind: type[Any]) -> str:
    """Return the first sentence of a fault's docstring."""
    return inspect.getdoc(kind).split("\n")[0].rstrip(".")  # type: ignore[union-attr]


def describe_fault(name: str) -> str:
    """Describe the parameters of a fault, or the entries of a preset.

    Raises
    ------
    ConfigError
        If neither a fault nor a preset has that name.
    """
    # A preset takes precedence over a fault of the same name.
    if name in preset_names():
        preset = read_preset(name)
        parts = write_yaml(preset["faults"], flow=None)
        use = f"use: - {{preset: {name}, at_s: 20}}"
        return f"{name}: {preset['about']}\n\nas faults:\n{parts}\n{use}"
    kind = fault_class(name)
    if kind is None:
        known = suggest_known(name, [*known_faults(), *known_aliases(), *preset_names()])
        raise ConfigError(f"faults show: {name} is neither a fault nor a preset; {known}")
    lines = [f"{name}: {inspect.getdoc(kind)}", "", f"target: {TARGETS[kind.acts_on]}"]
    if acts_on_ranges(kind):
        lines.append(f"   or   {TARGETS['satellites']}")
    for field in msgspec.structs.fields(kind):
        # Fields filled from the target are not parameters.
        if field.name not in TARGET_FIELDS:
            lines.append(f"{field.name}: {format_type(field.type)}{_default(field)}")
    if hasattr(kind, "example"):
        entry = {"fault": name, "at_s": 20, **kind.example}
        # On one line, for copying.
        text = write_yaml(entry, flow=True, width=1000)
        lines += ["", f"use: - {text.rstrip()}"]
    return "\n".join(lines)


def format_type(kind: Any) -> str:
    """Format a type for a reader of YAML."""
    described = msgspec.json.schema(kind)
    choices = described.get("anyOf", [described])
    words = []
    for choice in choices:
        if "$ref" in choice:
            words.append(choice["$ref"].rsplit("/", 1)[1].lower())
        elif "enum" in choice:
            words.append(" | ".join(str(one) for one in choice["enum"]))
        elif "type" in choice:
            words.append({"array": "list", "null": "nothing"}.get(choice["type"], choice["type"]))
    return " or ".join(words)


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.required:
        return " (required)"
    return "" if field.default is None else f" (default {field.default})"


def describe_entry(entry: Entry) -> str:
    """Describe one entry: fault, target, start and duration."""
    words = [entry.preset or entry.name, ", ".join(entry.targets) or "everything"]
    if entry.when:
        words.append(f"when {entry.when}")
    elif entry.after:
        words.append(f"after the {entry.after.event} of {entry.after.id}")
    else:
        moment = f" after {entry.written['from']}" if entry.moment is not None else ""
        words.append(f"from {entry.at_s:g} s{moment}")
    words.append("without end" if entry.for_s is None else f"for {entry.for_s:g} s")
    return ", ".join(words)


def _plot(args: argparse.Namespace) -> None:
    from mavproxy_fault.app.preview import draw_preview

    name = args.file
    # A file takes precedence over a preset of the same name.
    if name in preset_names() and not Path(name).exists():
        schedule = parse_schedule({"faults": [{"preset": name}]})
    else:
        schedule = read_schedule(name)
    out = Path(args.out or Path(name).with_suffix(".png").name)
    draw_preview(schedule, out)
    print(out)


def schedule_schema() -> dict[str, Any]:
    """Return the JSON Schema of schedules, for editors."""
    faults = known_faults()
    kinds = [EntryKeys, *faults.values()]
    found, components = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    keys = components[found[0]["$ref"].rsplit("/", 1)[1]]["properties"]
    # Fields filled from the target are not keys of a schedule.
    hidden = set(TARGET_FIELDS)
    choices = []
    for name, ref in zip(faults, found[1:], strict=True):
        own = components[ref["$ref"].rsplit("/", 1)[1]]
        properties = {k: v for k, v in own["properties"].items() if k not in hidden}
        required = [key for key in own.get("required", []) if key not in hidden]
        names = [name, *getattr(faults[name], "aliases", ())]
        choices.append(
            {
                "description": inspect.getdoc(faults[name]),
                "properties": {**keys, **properties, "fault": {"enum": names}},
                "required": ["fault", *required],
                # So that an editor marks misspelt keys, the most common mistake.
                "additionalProperties": False,
            }
        )
    preset = {
        "properties": {**keys, "preset": {"enum": list(preset_names())}},
        "required": ["preset"],
    }
    # The faults' schemas are inlined above; the rest are the types that they refer to.
    used = {name: part for name, part in components.items() if name not in _names(found)}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A schedule of mavproxy-fault",
        "type": "object",
        "properties": {
            "seed": {"type": "integer", "minimum": 0},
            "faults": {"type": "array", "items": {"anyOf": [*choices, preset]}},
        },
        "additionalProperties": False,
        "$defs": used,
    }


def _names(refs: tuple[dict[str, Any], ...]) -> set[str]:
    return {ref["$ref"].rsplit("/", 1)[1] for ref in refs}
