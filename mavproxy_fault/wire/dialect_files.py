"""MAVLink dialects of the user: XML files with their includes, read by pymavlink's generator.

References
----------
.. [1] MAVLink developer guide, "MAVLink XML Schema".
"""

import contextlib
import io
import json
import logging
import os
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from mavproxy_fault.documents.errors import ConfigError

# XML files, separated as in PATH; a variable, so that every process of a command knows them.
DIALECT_VARIABLE = "MAVPROXY_FAULT_DIALECT"
SESSION = "session.json"
LOG = logging.getLogger(__name__)

Table = dict[str, dict[str, Any]]


def dialect_paths() -> list[Path]:
    """Return the XML files of the user."""
    return [Path(name) for name in os.environ.get(DIALECT_VARIABLE, "").split(os.pathsep) if name]


def add_dialects(table: Mapping[str, dict[str, Any]], paths: list[Path]) -> Table:
    """Return a table of messages with those of XML files, which replace messages of their name.

    Two messages with one id, or two forms of one message, are reported; the later file counts. Of
    forms that differ in extension fields only, the one with more fields does.

    Raises
    ------
    ConfigError
        If a file or an included one cannot be read, or a message lacks fields of the present one.
    """
    merged = dict(table)
    names = {entry["id"]: name for name, entry in merged.items()}
    for path in paths:
        for name, entry in read_dialect(path)[0].items():
            present, other = merged.get(name), names.get(entry["id"], name)
            if present is not None:
                if _identity(present) == _identity(entry):
                    if len(present["fields"]) > len(entry["fields"]):
                        continue
                else:
                    _check_form(path, name, entry, present)
                    names.pop(present["id"], None)
            if other != name:
                LOG.warning("%s: message %d is %s and no longer %s", path, entry["id"], name, other)
                del merged[other]
            merged[name] = entry
            names[entry["id"]] = name
    return merged


def _identity(entry: Mapping[str, Any]) -> tuple[int, int]:
    return entry["id"], entry["crc_extra"]


def _check_form(
    path: Path, name: str, entry: Mapping[str, Any], present: Mapping[str, Any]
) -> None:
    """Report another form of a message, and refuse it if fields are missing in it."""
    fields = {field[0] for field in entry["fields"]}
    lacking = [field[0] for field in present["fields"] if field[0] not in fields]
    if lacking:
        raise ConfigError(
            f"--dialect {path}: {name} lacks {', '.join(lacking)} of the message of that name; "
            "add the fields, or rename the message"
        )
    LOG.warning("%s: frames of the former %s (id %d, CRC extra %d) are unknown now",
                path, name, *_identity(present))  # fmt: skip


def read_dialect(path: Path) -> tuple[Table, str]:
    """Return the messages of a file, after those of its includes, and the SHA-256 of all files.

    Raises
    ------
    ConfigError
        If one of them cannot be read.
    """
    read: dict[Path, Table] = {}
    messages = _read_file(path, read)
    return messages, sha256(b"".join(place.read_bytes() for place in read)).hexdigest()


def record_dialects() -> dict[str, list[dict[str, str]]]:
    """Return the entry of `session.json` with the user's files and their digests, if any."""
    files = [{"file": str(path), "sha256": read_dialect(path)[1]} for path in dialect_paths()]
    return {"dialects": files} if files else {}


def find_recorded(places: Iterable[str], given: list[str]) -> list[str]:
    """Return the further files with which the recordings at these places were made.

    One that is missing or has changed is reported, unless its content is among the given files.
    """
    found: list[str] = []
    sessions = {
        one for place in places for one in (Path(place, SESSION), Path(place).parent / SESSION)
    }
    for session in sorted(one for one in sessions if one.is_file()):
        for one in json.loads(session.read_text()).get("dialects", ()):
            name, digest = one["file"], one["sha256"]
            if digest in {_digest(file) for file in [*given, *found]}:
                continue
            if _digest(name) == digest:
                found.append(name)
            else:
                text = "%s: recorded with %s, which is missing or has changed; give --dialect a %s"
                LOG.warning(text, session, name, f"file of SHA-256 {digest}")
    return found


def _digest(name: str) -> str:
    try:
        return read_dialect(Path(name))[1] if Path(name).is_file() else ""
    except ConfigError:
        return ""


def _read_file(path: Path, read: dict[Path, Table]) -> Table:
    """Return the messages of a file after those of its includes; `read` are the files so far."""
    place = path.resolve()
    if place in read:
        return {}
    read[place] = {}
    found = _parse(path)
    messages: Table = {}
    for include in found.include:
        messages |= _read_file(path.parent / include, read)
    return messages | {message.name: _entry(message) for message in found.message}


def _parse(path: Path) -> Any:
    from pymavlink.generator import mavparse

    try:
        # It prints remarks on enumerations.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return mavparse.MAVXML(str(path), "2.0")
    except OSError as error:
        raise ConfigError(f"--dialect {path}: {error.strerror}; give a MAVLink XML file") from None
    except (ExpatError, mavparse.MAVParseError, ValueError, KeyError, SystemExit) as error:
        raise ConfigError(f"--dialect {path}: {error}; give a MAVLink XML file") from None


def _entry(message: Any) -> dict[str, Any]:
    """Return a message as in `messages.json`."""
    start = message.extensions_start
    extensions = set() if start is None else {field.name for field in message.fields[start:]}
    instance = [field.name for field in message.fields if field.instance]
    fields = [
        [
            field.name,
            field.type,
            field.array_length,
            field.units.strip("[]"),
            field.name in extensions,
        ]
        for field in message.ordered_fields
    ]
    return {
        "id": message.id,
        "crc_extra": message.crc_extra,
        "instance": instance[0] if instance else "",
        "fields": fields,
    }
