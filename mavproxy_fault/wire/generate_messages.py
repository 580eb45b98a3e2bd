"""Write `messages.json`, the table of message layouts, from pymavlink's `all` dialect.

Importing a pymavlink dialect takes half a second, most of it for enumerations the proxy never
reads; the table loads in milliseconds. A test keeps the two equal. Run
`python -m mavproxy_fault.wire.generate_messages` after a new pymavlink release.
"""

import json
import xml.etree.ElementTree as ET
from importlib.resources import files
from pathlib import Path
from typing import Any

TABLE_PATH = Path(__file__).with_name("messages.json")


def extension_fields() -> dict[str, set[str]]:
    """Return the extension fields of each message, which only the XML files identify."""
    extensions: dict[str, set[str]] = {}
    for path in files("pymavlink.dialects.v20").iterdir():
        if not path.name.endswith(".xml"):
            continue
        for message in ET.fromstring(path.read_text()).iter("message"):
            tags = list(message)
            # Every field after the empty tag <extensions/> is an extension.
            marks = [i for i, tag in enumerate(tags) if tag.tag == "extensions"]
            names = (
                {t.attrib["name"] for t in tags[marks[0] :] if t.tag == "field"} if marks else set()
            )
            extensions.setdefault(message.attrib["name"], names)
    return extensions


def build_message_table() -> dict[str, Any]:
    """Return id, CRC extra and fields ([name, type, count, unit, extension]) by message name."""
    from pymavlink.dialects.v20 import all as dialect

    extensions = extension_fields()
    messages = {}
    for number, message in sorted(dialect.mavlink_map.items()):
        types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
        fields = [
            [
                name,
                types[name],
                count,
                message.fieldunits_by_name.get(name, ""),
                name in extensions.get(message.msgname, ()),
            ]
            for name, count in zip(message.ordered_fieldnames, message.array_lengths, strict=True)
        ]
        messages[message.msgname] = {
            "id": number,
            "crc_extra": message.crc_extra,
            "instance": message.instance_field or "",
            "fields": fields,
        }
    return messages


if __name__ == "__main__":
    rows = (
        f"{json.dumps(name)}: {json.dumps(entry)}" for name, entry in build_message_table().items()
    )
    # One message per line, so that the diff of a new pymavlink release is readable.
    TABLE_PATH.write_text("{\n" + ",\n".join(rows) + "\n}\n")
