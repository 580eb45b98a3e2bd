"""Message layouts: the position, type and unit of every field in a MAVLink payload.

The table has the messages of MAVLink and ArduPilot (see `docs/write_messages.py`) and those of the
user's XML files (see `dialect_files`). On the wire, fields are sorted by size; extension fields
follow in definition order and exist only in MAVLink 2 [1]_.

References
----------
.. [1] MAVLink developer guide, "Packet Serialization", "Message Extensions".
"""

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect_files import add_dialects, dialect_paths

CODES = {
    "char": "c",
    "uint8_t": "B",
    "int8_t": "b",
    "uint16_t": "H",
    "int16_t": "h",
    "uint32_t": "I",
    "int32_t": "i",
    "uint64_t": "Q",
    "int64_t": "q",
    "float": "f",
    "double": "d",
}
# MAVLink fields are little-endian and unpadded.
PACKERS = {code: struct.Struct("<" + code) for code in CODES.values()}


@dataclass(frozen=True, slots=True)
class Field:
    """One field: `count` is 0 for a scalar, otherwise the array length; `offset` is in bytes.

    `code`, `packer` and `size` are the `struct` code, `Struct` and byte size of one element;
    `length` is the byte size of the entire field. They are kept, so that reading a value needs no
    lookups.
    """

    name: str
    type: str
    count: int
    unit: str
    extension: bool
    offset: int
    code: str
    packer: struct.Struct
    size: int
    length: int


@dataclass(frozen=True, slots=True)
class Layout:
    """One message: `length` is the full payload, `base_length` excludes extensions (MAVLink 1).

    `instance` names the field that distinguishes sensors of one kind, by the dialect or `id` ("" if
    none does).
    """

    name: str
    id: int
    crc_extra: int
    instance: str
    fields: dict[str, Field]
    length: int
    base_length: int


def built_in_messages() -> dict[str, Any]:
    """Return the built-in table: `messages` by name, and `sources`, the versions of their XML."""
    table: dict[str, Any] = json.loads(Path(__file__).with_name("messages.json").read_bytes())
    return table


@cache
def _message_table() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = built_in_messages()["messages"]
    return add_dialects(table, dialect_paths())


@cache
def _names_by_id() -> dict[int, str]:
    return {entry["id"]: name for name, entry in _message_table().items()}


def message_names() -> list[str]:
    """Return the sorted names of all messages in the dialect."""
    return sorted(_message_table())


@cache
def find_layout(key: str | int) -> Layout | None:
    """Look up a message's layout by name or id; None if it is not in the dialect."""
    name = key if isinstance(key, str) else _names_by_id().get(key)
    entry = _message_table().get(name) if name is not None else None
    if name is None or entry is None:
        return None
    fields = {}
    offset = base_length = 0
    for field_name, type_name, count, unit, extension in entry["fields"]:
        code = CODES[type_name]
        packer = PACKERS[code]
        length = packer.size * max(count, 1)
        fields[field_name] = Field(
            field_name, type_name, count, unit, extension, offset, code, packer, packer.size, length
        )
        offset += length
        # Extensions come last, so the MAVLink 1 payload ends before the first of them.
        if not extension:
            base_length = offset
    instance = entry["instance"] or ("id" if "id" in fields else "")
    return Layout(name, entry["id"], entry["crc_extra"], instance, fields, offset, base_length)


def describe_unknown(counts: Mapping[int, int]) -> str:
    """Describe frames of unknown messages, given their number by message id."""
    ids = sorted(counts)
    # Consecutive ids become one range.
    starts = [number for number in ids if number - 1 not in counts]
    ends = [number for number in ids if number + 1 not in counts]
    ranges = [
        f"{first}" if first == last else f"{first} to {last}"
        for first, last in zip(starts, ends, strict=True)
    ]
    return f"{sum(counts.values()):,} frames of unknown messages {', '.join(ranges)}"


def message_layout(key: str | int) -> Layout:
    """Return the layout of a message that must exist, by name or id.

    Raises
    ------
    ConfigError
        If the dialect has no such message, which only a user's XML file can cause.
    """
    layout = find_layout(key)
    if layout is None:
        raise ConfigError(f"--dialect: {key} is missing, another message has its id; change that")
    return layout
