"""MAVLink dialects of the user: XML files with their includes, read by pymavlink's generator.

References
----------
.. [1] MAVLink developer guide, "MAVLink XML Schema".
"""

import contextlib
import io
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from mavproxy_fault.documents.errors import ConfigError

LOG = logging.getLogger(__name__)

Table = dict[str, dict[str, Any]]


def add_dialects(table: Mapping[str, dict[str, Any]], paths: list[Path]) -> Table:
    """Return a table of messages with those of XML files, which replace messages of their name.

    Two messages with one id are reported; the one of the later file is used.

    Raises
    ------
    ConfigError
        If a file or an included one cannot be read.
    """
    merged = dict(table)
    names = {entry["id"]: name for name, entry in merged.items()}
    for path in paths:
        for name, entry in _read_file(path, {}).items():
            other = names.get(entry["id"], name)
            if other != name and other in merged:
                LOG.warning("%s: message %d is %s and no longer %s", path, entry["id"], name, other)
                del merged[other]
            merged[name] = entry
            names[entry["id"]] = name
    return merged


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
