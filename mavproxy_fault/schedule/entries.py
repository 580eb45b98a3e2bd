"""Schedules and their entries, read from YAML; all errors are reported with their lines."""

import reprlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.document_check import DocumentCheck
from mavproxy_fault.documents.document_kind import check_kind
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import (
    Document,
    Flaw,
    FlawedDocumentError,
    Path,
    read_document,
    read_yaml,
)
from mavproxy_fault.fault_parts.fault import Fault
from mavproxy_fault.fault_parts.profile import Duration, Profile, Seconds
from mavproxy_fault.faults.registry import fault_class, known_aliases, known_faults
from mavproxy_fault.schedule.binding import TARGET_FIELDS, bind_fault, resolve_target, target_errors
from mavproxy_fault.schedule.cross_checks import check_together, default_id, entry_ids
from mavproxy_fault.schedule.presets import preset_names, preset_parts
from mavproxy_fault.schedule.triggers import Condition, event_condition

SCHEDULE_KEYS = ("seed", "faults")
Via = Literal["proxy", "simulator"]
Clock = Literal["vehicle", "link"]
Byte = Annotated[int, Meta(ge=0, le=255)]


class Where(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Filter for frames: sender, instance (the message's `id`) and direction; None means any.

    `endpoint` is one by number (0 for the master, then the outputs in their order): frames that
    come from it, and what is sent to it, but not what is sent to others.
    """

    system: Byte | None = None
    component: Byte | None = None
    id: int | None = None
    direction: Literal["to-vehicle", "from-vehicle"] | None = None
    endpoint: Annotated[int, Meta(ge=0, le=62)] | None = None  # as a bit of 64


class After(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start when another fault starts or ends, or `delay_s` later."""

    id: str
    event: Literal["start", "end"] = "end"
    delay_s: Seconds = 0.0


class Repeat(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start again every `every_s` seconds, `times` times in total (default: unlimited).

    Without `every_s`, start each time that the condition `when` becomes true again.
    """

    every_s: Duration | None = None
    times: Annotated[int, Meta(ge=1)] | None = None


class EntryKeys(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    rename={"count_from": "from"},
):
    """The keys that every entry of a schedule may have, besides the parameters of its fault.

    `at_s` counts from the flight event `from`. With `via: simulator` a satellite fault acts in
    the simulated receiver instead of on the wire. `clock` is what its times and its fault count in,
    by default link time for faults of the link, else vehicle time.
    """

    id: str | None = None
    fault: str | None = None
    preset: str | None = None
    target: str | tuple[str, ...] = ()
    count_from: str | None = None
    at_s: Seconds = 0.0
    for_s: Duration | None = None
    when: str | None = None
    after: str | After | None = None
    repeat: Repeat | None = None
    where: Where = Where()
    probability: Annotated[float, Meta(ge=0, le=1)] = 1.0
    via: Via | None = None
    clock: Clock | None = None


KEYS = tuple(field.encode_name for field in msgspec.structs.fields(EntryKeys))


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """One fault of a schedule, ready to run.

    `ids` are the messages it acts on (None: all); `written` are the keys as the user wrote them.
    `at_s` counts from the time at which the condition `moment` becomes true, if there is one.
    """

    id: str
    name: str
    fault: Fault
    ids: frozenset[int] | None
    condition: Condition | None = None
    moment: Condition | None = None
    targets: tuple[str, ...] = ()
    preset: str | None = None
    at_s: float = 0.0
    for_s: float | None = None
    when: str | None = None
    after: After | None = None
    repeat: Repeat | None = None
    where: Where = Where()
    probability: float = 1.0
    clock: Clock = "vehicle"
    written: dict[str, Any] = {}

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters of the fault, as written."""
        return {key: value for key, value in self.written.items() if key not in KEYS}


class Schedule(msgspec.Struct, frozen=True):
    """The seed and the entries in the order in which they act on a frame."""

    seed: int = 0
    faults: tuple[Entry, ...] = ()


def never_acted(schedule: Schedule, acted: Collection[str]) -> list[str]:
    """Return the entries that matched no message, given the ids of those that did.

    A preset lists every message that may carry its sensor, so one matching part is enough.
    """
    idle: dict[str, bool] = {}
    for entry in schedule.faults:
        name = entry.id if entry.preset is None else entry.written.get("id", entry.preset)
        word = f"{name} ({entry.preset or entry.name})"
        idle[word] = idle.get(word, True) and entry.id not in acted
    return [word for word, never in idle.items() if never]


def read_schedule(path: FilePath | str, via: Via = "proxy") -> Schedule:
    """Read the schedule of a YAML file; `via` is the default of satellite faults.

    Raises
    ------
    ConfigError
        If the file cannot be read or has errors: all of them, with their lines.
    """
    try:
        return parse_schedule(read_document(path), via=via)
    except FlawedDocumentError as error:
        # Errors of its entries are reported together with the flaws.
        return parse_schedule(error.document, via=via, flaws=error.flaws)


def parse_schedule(
    source: Document | dict[str, Any] | str,
    where: str = "schedule",
    via: Via = "proxy",
    flaws: Sequence[Flaw] = (),
) -> Schedule:
    """Parse the schedule of a document, a YAML text or data.

    `where` is the name in errors; `flaws` are errors found before.

    Raises
    ------
    ConfigError
        If there are errors: all of them, with their lines if known.
    """
    if isinstance(source, str):
        source = read_yaml(source, where)
    # Data from a program has no lines.
    document = source if isinstance(source, Document) else Document(source, where, {})
    check = DocumentCheck(document.where, document.lines, flaws)
    data = check_kind(document, SCHEDULE_KEYS, "a schedule")
    check.keys(data, SCHEDULE_KEYS, ())
    seed = check.value(data.get("seed", 0), Annotated[int, Meta(ge=0)], ("seed",))
    listed = data.get("faults") or []
    entries: list[Entry] = []
    # All entries are read before errors are raised, to report all of them.
    if isinstance(listed, list):
        for i, item in enumerate(listed):
            entries += _entries(item, i, check, ("faults", i), via)
        # On the data as written, since an invalid entry still counts as existing.
        check_together(listed, check)
    else:
        check.wrong(("faults",), "is not a list; give `- id: ...` items")
    check.finish()
    return Schedule(seed, tuple(entries))


def parse_entry(data: dict[str, Any], where: str) -> list[Entry]:
    """Parse a single item of a schedule (several entries for a preset of several parts).

    Raises
    ------
    ConfigError
        If there are errors: all of them.
    """
    check = DocumentCheck(where)
    entries = _entries(data, 0, check, (), "proxy")
    check.finish()
    return entries


def _entries(data: Any, number: int, check: DocumentCheck, path: Path, via: Via) -> list[Entry]:
    if not isinstance(data, dict):
        text = f"= {reprlib.repr(data)} is not a fault; give keys such as `fault`, `target`, `at_s`"
        check.wrong(path, text)
        return []
    if "preset" in data:
        return _from_preset(data, number, check, path, via)
    entry = _entry(data, number, check, path, via)
    return [] if entry is None else [entry]


def _resolve_files(arguments: dict[str, Any], check: DocumentCheck, path: Path) -> None:
    """Resolve files relative to the schedule: read samples and series."""
    samples, profile = arguments.get("file"), arguments.get("profile")
    if isinstance(samples, str):
        from mavproxy_fault.faults.timing import read_samples

        try:
            arguments["samples"] = read_samples(FilePath(check.where).parent / samples)
        except ConfigError as error:
            check.wrong((*path, "file"), f"= {samples}: {error}")
    if not isinstance(profile, Profile) or profile.table is None:
        return
    from mavproxy_fault.fault_parts.series import read_series

    # Relative to the schedule, not to the working directory.
    file = FilePath(check.where).parent / profile.table.file
    table = msgspec.structs.replace(profile.table, file=str(file))
    arguments["profile"] = msgspec.structs.replace(profile, table=table)
    try:
        read_series(table)
    except ConfigError as error:
        check.wrong((*path, "profile", "table", "file"), f"= {profile.table.file}: {error}")


def _from_preset(
    data: dict[str, Any], number: int, check: DocumentCheck, path: Path, via: Via
) -> list[Entry]:
    name = data["preset"]
    if "fault" in data:
        check.wrong((*path, "fault"), "and preset exclude each other; give one of them")
    if name not in preset_names():
        text = f"= {reprlib.repr(name)} is unknown; {suggest_known(str(name), preset_names())}"
        check.wrong((*path, "preset"), text)
        return []
    entries = []
    parts = preset_parts(name)
    # The keys of the item take precedence over those of each part.
    own = {key: value for key, value in data.items() if key != "fault"}
    before = check.count
    check.value(data.get("id"), str | None, (*path, "id"))
    for part, id in zip(parts, entry_ids(data, number), strict=True):
        entry = _entry({**part, **own, "id": id}, number, check, path, via)
        if entry is not None:
            entries.append(msgspec.structs.replace(entry, preset=name, written=data))
        if check.count > before:  # the same error would repeat in each part
            break
    return entries


def _entry(
    data: dict[str, Any], number: int, check: DocumentCheck, path: Path, via: Via
) -> Entry | None:
    before = check.count
    keys = check.arguments({k: v for k, v in data.items() if k in KEYS}, EntryKeys, path, ())
    _check_repeat(keys, check, path)
    keys["condition"] = _condition(keys.get("when"), check, (*path, "when"), Condition)
    keys["moment"] = _condition(
        keys.pop("count_from", None), check, (*path, "from"), event_condition
    )
    if keys["moment"] is not None and "after" in keys:
        check.wrong((*path, "from"), "and after exclude each other; give one of them")
    name = keys.pop("fault", None)
    kind = _fault_kind(name, data, check, path)
    if kind is None:
        return None
    own = [field.name for field in msgspec.structs.fields(kind) if field.name not in TARGET_FIELDS]
    check.keys(data, (*KEYS, *own), path)
    arguments = check.arguments(data, kind, path, TARGET_FIELDS)
    _resolve_files(arguments, check, path)
    names = keys.pop("target", None) or ()
    names = (names,) if isinstance(names, str) else tuple(names)
    # An invalid target value already has its error.
    for text in target_errors(name, kind, names) if None not in names else ():
        check.wrong((*path, "target"), f"= {text}" if names else text)
    # Binding needs valid fields.
    if check.count > before:
        return None
    resolved = resolve_target(name, kind, names)
    # Only satellite faults can act in the proxy or in the simulator.
    wanted = keys.pop("via", None) or (via if resolved.satellites else "proxy")
    try:
        fault, ids = bind_fault(kind, arguments, resolved, wanted)
    except ValueError as error:
        check.refused(kind, str(error), path)
        return None
    after = keys.pop("after", None)
    keys["after"] = After(id=after) if isinstance(after, str) else after
    keys["id"] = keys.get("id") or default_id(name, number)
    keys["clock"] = keys.get("clock") or getattr(fault, "clock", "vehicle")
    return Entry(name=name, fault=fault, ids=ids, targets=names, written=data, **keys)


def _fault_kind(
    name: str | None, data: dict[str, Any], check: DocumentCheck, path: Path
) -> type[Any] | None:
    """Return the class of the fault; add an error and return None if it does not exist."""
    kind = fault_class(name) if name is not None else None
    if name is not None and kind is None:
        known = [*known_faults(), *known_aliases()]
        check.wrong((*path, "fault"), f"= {name} is unknown; {suggest_known(name, known)}")
    elif "fault" not in data:
        check.wrong(path, "lacks fault; give `fault` or `preset`")
    return kind


def _check_repeat(keys: dict[str, Any], check: DocumentCheck, path: Path) -> None:
    repeat, for_s = keys.get("repeat"), keys.get("for_s")
    if repeat is None:
        return
    if "for_s" not in keys:
        check.wrong((*path, "repeat"), "needs for_s, since an endless fault cannot restart; add it")
    if repeat.every_s is None and keys.get("when") is None:
        check.wrong((*path, "repeat"), "lacks every_s, required without `when`; add it")
    # Repetitions must not overlap.
    if repeat.every_s is not None and for_s is not None and repeat.every_s < for_s:
        text = f"= {repeat.every_s:g} is shorter than for_s = {for_s:g}; give that or more"
        check.wrong((*path, "repeat", "every_s"), text)


def _condition(
    text: str | None, check: DocumentCheck, path: Path, read: Callable[[str], Condition | None]
) -> Condition | None:
    """Parse a condition; None without a text, or after adding an error."""
    try:
        return None if text is None else read(text)
    except ValueError as error:
        check.wrong(path, str(error))
        return None
