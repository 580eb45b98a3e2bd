"""Write docs/keys.md: every key of every file, every fault and every preset, from the sources.

python docs/write_reference.py
"""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.monitor.pipeline import MonitorSection
from analysis.report.judging.check_limits import Thresholds
from analysis.scoring.criteria import Criteria
from analysis.search.space.test_file import TestFile
from mavproxy_fault.app.catalogue import describe_fault, format_type, list_catalogue
from mavproxy_fault.schedule.entries import EntryKeys
from simvehicle.scenario.scenario_file import Scenario

FILE = Path(__file__).with_name("keys.md")
FILES = {
    "Scenario": (Scenario, "`run`, `sim`; how the keys work: [simulator.md](simulator.md)."),
    "Schedule entry": (EntryKeys, "An item of `faults`; [faults.md](faults.md)."),
    "Monitor": (MonitorSection, "`monitor` of a scenario; [fdi.md](fdi.md)."),
    "Criteria": (Criteria, "`criteria` of a scenario; [verdicts.md](verdicts.md)."),
    "Campaign": (CampaignFile, "`campaign`; [campaigns.md](campaigns.md)."),
    "Test file": (TestFile, "`search`; [search.md](search.md)."),
    "Thresholds": (Thresholds, "`report --criteria`; [reports.md](reports.md)."),
}
HEAD = """# Every key of every file

Written by `python docs/write_reference.py` from the sources; a test holds it to them. Units are in
the names; a section has its keys under a heading of its own, below.
"""


def sections(kind: Any, path: str, seen: set[Any]) -> Iterator[tuple[str, type[msgspec.Struct]]]:
    """Yield a struct and the structs below it, each type once, with the path of its key."""
    if kind in seen:
        return
    seen.add(kind)
    yield path, kind
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if name in {field.name for field in msgspec.structs.fields(kind)}:
            for inner in structs_in(hint):
                yield from sections(inner, f"{path}.{name}".lstrip("."), seen)


def structs_in(hint: Any) -> Iterator[type[msgspec.Struct]]:
    """Yield the structs in a type."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield hint
    for inner in get_args(hint):
        yield from structs_in(inner)


def default_of(field: msgspec.structs.FieldInfo) -> str:
    """Format a default value."""
    if field.required:
        return "required"
    value = field.default
    if value is msgspec.NODEFAULT:
        value = field.default_factory()  # type: ignore[operator]
    if isinstance(value, msgspec.Struct):
        return "as below"
    return "" if value in (None, (), {}, []) else f"`{value}`"


def key_table(kind: type[msgspec.Struct]) -> list[str]:
    """Format the keys of a struct."""
    lines = ["| key | value | default |", "|---|---|---|"]
    for field in msgspec.structs.fields(kind):
        words = format_type(field.type).replace("|", "or") or "see below"
        for inner in structs_in(field.type):
            words = words.replace(inner.__name__.lower(), "section")
        lines.append(f"| `{field.encode_name}` | {words} | {default_of(field)} |")
    return lines


def reference() -> str:
    """Return the page."""
    lines = [HEAD]
    for title, (root, use) in FILES.items():
        lines += [f"## {title}", "", use, ""]
        for path, kind in sections(root, "", set()):
            if path:
                lines += [f"### `{path}` ({title.lower()})", ""]
            about = inspect.getdoc(kind) or ""
            lines += [" ".join(about.split("\n\n")[0].split()), "", *key_table(kind), ""]
    for title, names in list_catalogue().items():
        lines += [f"## All {title}", ""]
        for name in names:
            lines += [
                f"### `{name}` ({title[:-1]})",
                "",
                "```text",
                describe_fault(name),
                "```",
                "",
            ]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    FILE.write_text(reference(), encoding="utf-8")
