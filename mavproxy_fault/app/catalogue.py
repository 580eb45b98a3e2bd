"""`mavproxy-fault faults`: list faults and presets; check and plot schedules."""

import argparse
import inspect
import json
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from mavproxy_fault.app.command_result import open_console, plain_table, print_result
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
        if args.messages:
            sources = [
                "built in: " + " ".join(text for key, text in one.items() if key != "sha256")
                for one in built_in_messages()["sources"]
            ] + [f"dialect: {path}" for path in dialect_paths()]
            messages = {name: message_layout(name).id for name in message_names()}
            by_id = sorted(messages, key=messages.__getitem__)
            lines = [*sources, *(f"{messages[name]:8}  {name}" for name in by_id)]
            print_result(args, {"sources": sources, "messages": messages}, "\n".join(lines))
        else:
            catalogue = list_catalogue()
            print_result(args, catalogue, partial(show_catalogue, catalogue))
    elif args.action == "show":
        text = describe_fault(args.name)
        print_result(args, {"name": args.name, "text": text}, text)
    elif args.action == "check":
        faults = {entry.id: describe_entry(entry) for entry in read_schedule(args.file).faults}
        text = "".join(f"\n  {id}: {described}" for id, described in faults.items())
        count = f"{len(faults)} fault{'s' * (len(faults) != 1)}"
        print_result(args, {"faults": faults}, f"{args.file}: {count}: OK{text}")
    elif args.action == "plot":
        _plot(args)
    else:
        print(json.dumps(schedule_schema(), indent=2))
    return 0


def fault_and_preset_names() -> list[str]:
    """Return every name that `inject` and `faults show` know."""
    return [*known_faults(), *known_aliases(), *preset_names()]


def list_catalogue() -> dict[str, dict[str, str]]:
    """Return what each fault and each preset does, in one line."""
    faults = {}
    for name, kind in known_faults().items():
        aliases = ", ".join(getattr(kind, "aliases", ()))
        faults[name] = first_line(kind) + (f" (also {aliases})" if aliases else "")
    presets = {name: str(read_preset(name)["about"]) for name in preset_names()}
    return {"faults": faults, "presets": presets}


def show_catalogue(catalogue: dict[str, dict[str, str]]) -> None:
    """Print all faults and presets as tables, as wide as the terminal."""
    for title, rows in catalogue.items():
        table = plain_table(title, "what it does")
        for row in rows.items():
            table.add_row(*row)
        open_console().print(table)


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
        known = suggest_known(name, fault_and_preset_names())
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
    print_result(args, {"plot": out}, str(out))


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
    inlined = {ref["$ref"].rsplit("/", 1)[1] for ref in found}
    used = {name: part for name, part in components.items() if name not in inlined}
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
