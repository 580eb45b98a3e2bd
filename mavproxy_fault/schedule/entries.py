"""Schedules: which faults, when, on which frames; read from YAML with every error and its line."""

from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.checked import Check, Lines, Path, read_yaml
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import near
from mavproxy_fault.faults.fault import Fault
from mavproxy_fault.faults.profile import NotNegative, Positive, Profile
from mavproxy_fault.faults.registry import fault_class, known_aliases, known_faults
from mavproxy_fault.schedule.binding import GIVEN, aim, bind, wrong_targets
from mavproxy_fault.schedule.triggers import Condition

Via = Literal["proxy", "simulator"]
Byte = Annotated[int, Meta(ge=0, le=255)]


class Where(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Which frames: sender, instance (the message's own `id`) and direction; None takes all."""

    system: Byte | None = None
    component: Byte | None = None
    id: int | None = None
    direction: Literal["to-vehicle", "from-vehicle"] | None = None


class After(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start when another fault starts or ends, or `delay_s` later."""

    id: str
    event: Literal["start", "end"] = "end"
    delay_s: NotNegative = 0.0


class Repeat(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Start again every `every_s` seconds, `times` times in all (for ever by default).

    Without `every_s`, which needs a `when`: each time the condition becomes true again.
    """

    every_s: Positive | None = None
    times: Annotated[int, Meta(ge=1)] | None = None


class Keys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What every entry of a schedule may say; the fault's own parameters stand beside it.

    With `via: simulator` a satellite fault acts in the simulated receiver instead of on the wire.
    """

    id: str | None = None
    fault: str | None = None
    preset: str | None = None
    target: str | tuple[str, ...] = ()
    at_s: NotNegative = 0.0
    for_s: Positive | None = None
    when: str | None = None
    after: str | After | None = None
    repeat: Repeat | None = None
    where: Where = Where()
    probability: Annotated[float, Meta(ge=0, le=1)] = 1.0
    via: Via | None = None


KEYS = tuple(field.name for field in msgspec.structs.fields(Keys))


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """One fault of a schedule, ready to run.

    `ids` are the messages it acts on (None: all); `written` are the keys as the user wrote them.
    """

    id: str
    name: str
    fault: Fault
    ids: frozenset[int] | None
    condition: Condition | None = None
    targets: tuple[str, ...] = ()
    preset: str | None = None
    at_s: float = 0.0
    for_s: float | None = None
    when: str | None = None
    after: After | None = None
    repeat: Repeat | None = None
    where: Where = Where()
    probability: float = 1.0
    written: dict[str, Any] = {}

    @property
    def parameters(self) -> dict[str, Any]:
        """The fault's own parameters, as written."""
        return {key: value for key, value in self.written.items() if key not in KEYS}


class Schedule(msgspec.Struct, frozen=True):
    """The seed and the entries, in the order in which they act on a frame."""

    seed: int = 0
    faults: tuple[Entry, ...] = ()


def read_schedule(path: FilePath | str, via: Via = "proxy") -> Schedule:
    """The schedule of a YAML file; `via` is where satellite faults act that do not say.

    Raises
    ------
    ConfigError
        With every error of the file and its line, or if it cannot be read.
    """
    try:
        text = FilePath(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); give a schedule in YAML") from None
    return parse_schedule(text, str(path), via=via)


def parse_schedule(
    data: dict[str, Any] | str,
    where: str = "schedule",
    lines: Lines | None = None,
    via: Via = "proxy",
) -> Schedule:
    """The schedule of a YAML text, or of data already read; `where` names it in errors.

    Raises
    ------
    ConfigError
        With every error, each with its line where it is known.
    """
    if isinstance(data, str):
        data, lines = read_yaml(data, where)
    check = Check(where, lines)
    check.via = via
    if not isinstance(data, dict):
        raise ConfigError(f"{where}: is no schedule; give `seed` and a list of `faults`")
    check.keys(data, ("seed", "faults"), ())
    seed = check.value(data.get("seed", 0), Annotated[int, Meta(ge=0)], ("seed",))
    listed = data.get("faults") or []
    entries: list[Entry] = []
    if isinstance(listed, list):
        for i, item in enumerate(listed):
            entries += _entries(item, i, check, ("faults", i))
    else:
        check.wrong(("faults",), "is no list; give `- id: ...` items")
    _check_ids(entries, check)
    check.finish()
    return Schedule(seed, tuple(entries))


def parse_entry(data: dict[str, Any], where: str) -> list[Entry]:
    """One item of a schedule on its own (a preset of several parts gives several entries).

    Raises
    ------
    ConfigError
        With every error.
    """
    check = Check(where)
    entries = _entries(data, 0, check, ())
    check.finish()
    return entries


def _check_ids(entries: list[Entry], check: Check) -> None:
    seen: set[str] = set()
    ids = {entry.id for entry in entries}
    for i, entry in enumerate(entries):
        if entry.id in seen:
            check.wrong(("faults", i, "id"), f"= {entry.id} stands twice; ids must differ")
        seen.add(entry.id)
        if entry.after is not None and entry.after.id not in ids - {entry.id}:
            known = near(entry.after.id, ids - {entry.id})
            check.wrong(("faults", i, "after"), f"= {entry.after.id} is no other fault; {known}")


def _entries(data: Any, number: int, check: Check, path: Path) -> list[Entry]:
    if not isinstance(data, dict):
        check.wrong(path, f"= {data!r} is no fault; give keys such as `fault`, `target`, `at_s`")
        return []
    if "preset" in data:
        return _from_preset(data, number, check, path)
    entry = _entry(data, number, check, path)
    return [] if entry is None else [entry]


def _open_table(found: dict[str, Any], check: Check, path: Path) -> None:
    """Let a table's file lie beside the schedule, and see that it begins as it should."""
    profile = found.get("profile")
    if not isinstance(profile, Profile) or profile.table is None:
        return
    from mavproxy_fault.faults.series import read_blocks

    file = FilePath(check.where).parent / profile.table.file
    table = msgspec.structs.replace(profile.table, file=str(file))
    found["profile"] = msgspec.structs.replace(profile, table=table)
    try:
        next(read_blocks(table), None)
    except ConfigError as error:
        check.wrong((*path, "profile", "table", "file"), f"= {profile.table.file}: {error}")


def _from_preset(data: dict[str, Any], number: int, check: Check, path: Path) -> list[Entry]:
    from mavproxy_fault.schedule.presets import preset_names, preset_parts

    name = data["preset"]
    if "fault" in data:
        check.wrong((*path, "fault"), "stands beside preset; give one of them")
    if name not in preset_names():
        check.wrong((*path, "preset"), f"= {name} is unknown; {near(str(name), preset_names())}")
        return []
    entries = []
    parts = preset_parts(name)
    own = {key: value for key, value in data.items() if key != "fault"}
    for i, part in enumerate(parts):
        merged = {**part, **own}
        merged["id"] = data.get("id", name) + (f".{i + 1}" if len(parts) > 1 else "")
        entry = _entry(merged, number, check, path)
        if entry is not None:
            entries.append(msgspec.structs.replace(entry, preset=name, written=data))
    return entries


def _entry(data: dict[str, Any], number: int, check: Check, path: Path) -> Entry | None:
    before = len(check.errors)
    keys = check.arguments({k: v for k, v in data.items() if k in KEYS}, Keys, path, ())
    name = keys.pop("fault", None)
    kind = fault_class(name) if name is not None else None
    if name is None or kind is None:
        known = [*known_faults(), *known_aliases()]
        if name is not None:
            check.wrong((*path, "fault"), f"= {name} is unknown; {near(name, known)}")
        elif "fault" not in data:
            check.wrong(path, "lacks fault; give `fault` or `preset`")
        return None
    own = [field.name for field in msgspec.structs.fields(kind) if field.name not in GIVEN]
    check.keys(data, (*KEYS, *own), path)
    found = check.arguments(data, kind, path, GIVEN)
    names = keys.pop("target", None) or ()
    names = (names,) if isinstance(names, str) else tuple(names)
    for text in wrong_targets(name, kind, names):
        check.wrong((*path, "target"), f"= {text}" if names else text)
    if keys.get("repeat") is not None and data.get("for_s") is None:
        check.wrong((*path, "repeat"), "needs for_s; a fault that never ends cannot start again")
    repeat = keys.get("repeat")
    if repeat is not None and repeat.every_s is None and keys.get("when") is None:
        check.wrong((*path, "repeat"), "lacks every_s; only a fault with `when` can do without")
    if len(check.errors) > before:
        return None
    _open_table(found, check, path)
    try:
        via = keys.pop("via", None)
        at = aim(name, kind, names)
        if via is None and at.satellites:
            via = check.via
        fault, ids = bind(kind, found, at, via or "proxy")
    except ValueError as error:
        check.wrong(path, f"({name}) {error}")
        return None
    if keys.get("when") is not None:
        try:
            keys["condition"] = Condition(keys["when"])
        except ValueError as error:
            check.wrong((*path, "when"), str(error))
            return None
    after = keys.pop("after", None)
    keys["after"] = After(id=after) if isinstance(after, str) else after
    keys["id"] = keys.get("id") or f"{name}-{number + 1}"
    return Entry(name=name, fault=fault, ids=ids, targets=names, written=data, **keys)
