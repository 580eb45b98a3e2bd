"""Layouts: where the fields of each MAVLink message lie in its payload.

The table is pymavlink's `all` dialect (see `generate.py`). A message's fields are sorted by size on
the wire; extension fields follow in the order of their definition and exist in MAVLink 2 only [1]_.

References
----------
.. [1] MAVLink developer guide, "Packet Serialization", "Message Extensions".
"""

import json
import struct
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

CODES = {
    "char": "c",
    "uint8_t": "B",
    "uint8_t_mavlink_version": "B",  # pymavlink's name for the version in HEARTBEAT
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
# Little-endian and without padding, as MAVLink lays its fields out.
PACKERS = {code: struct.Struct("<" + code) for code in CODES.values()}


@dataclass(frozen=True, slots=True)
class Field:
    """One field: `count` is 0 for a scalar, else the length of the array; `offset` in bytes.

    `code` is the `struct` code of one element, `packer` its `Struct`, `size` its bytes, and
    `length` the bytes of the whole field.
    """

    name: str
    type: str
    count: int
    unit: str
    extension: bool
    offset: int
    code: str = field(init=False)
    packer: struct.Struct = field(init=False, compare=False, repr=False)
    size: int = field(init=False)
    length: int = field(init=False)

    def __post_init__(self) -> None:
        code = CODES[self.type]
        size = PACKERS[code].size
        # Set once, though frozen: reading a value must not look them up each time.
        object.__setattr__(self, "code", code)
        object.__setattr__(self, "packer", PACKERS[code])
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "length", size * max(self.count, 1))


@dataclass(frozen=True, slots=True)
class Layout:
    """One message: `length` is the full payload, `base_length` that without extensions (MAVLink 1).

    `instance` names the field that tells several sensors of one kind apart ("" where none does).
    """

    name: str
    id: int
    crc_extra: int
    instance: str
    fields: dict[str, Field]
    length: int
    base_length: int


@cache
def _message_table() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = json.loads(
        Path(__file__).with_name("messages.json").read_bytes()
    )
    return table


@cache
def _names_by_id() -> dict[int, str]:
    return {entry["id"]: name for name, entry in _message_table().items()}


def message_names() -> list[str]:
    """Names of all messages known, sorted."""
    return sorted(_message_table())


@cache
def find_layout(key: str | int) -> Layout | None:
    """The layout of a message by name or id; None if the dialect does not know it."""
    name = key if isinstance(key, str) else _names_by_id().get(key)
    entry = _message_table().get(name) if name is not None else None
    if name is None or entry is None:
        return None
    fields = {}
    offset = base_length = 0
    for field_name, type_name, count, unit, extension in entry["fields"]:
        one = Field(field_name, type_name, count, unit, extension, offset)
        fields[field_name] = one
        offset += one.length
        # Extensions come last, so the length of MAVLink 1 ends before the first of them.
        if not extension:
            base_length = offset
    return Layout(
        name, entry["id"], entry["crc_extra"], entry["instance"], fields, offset, base_length
    )


def message_layout(key: str | int) -> Layout:
    """The layout of a message the caller knows to exist.

    Raises
    ------
    KeyError
        If the dialect has no such message.
    """
    found = find_layout(key)
    if found is None:
        raise KeyError(key)
    return found
