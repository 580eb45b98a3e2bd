"""Write `messages.json`, the built-in table of message layouts, from MAVLink's XML files.

Reading the XML takes half a second; the table loads in milliseconds. After a new version of the
messages:

    git clone https://github.com/ArduPilot/mavlink ArduPilot
    git clone https://github.com/mavlink/mavlink MAVLink
    python docs/write_messages.py \\
        {MAVLink,ArduPilot}/message_definitions/v1.0/all.xml

ArduPilot's file comes last, since its senders of RAW_IMU give units that MAVLink leaves open; of
forms with one checksum the longer is used. `sources` in the table has for each file its
digest (with the includes) and, if it is in a clone, repository, commit and date.
"""

import json
import subprocess
import sys
from pathlib import Path

from mavproxy_fault.wire.dialect_files import add_dialects, read_dialect

TABLE_PATH = Path(__file__).parents[1] / "mavproxy_fault" / "wire" / "messages.json"


def describe_source(path: Path) -> dict[str, str]:
    """Return name, digest, repository, commit and date of an XML file."""
    described = {"file": path.name, "sha256": read_dialect(path)[1]}
    for key, words in (
        ("repository", ["remote", "get-url", "origin"]),
        ("commit", ["log", "-1", "--format=%H"]),
        ("date", ["log", "-1", "--format=%cs"]),
    ):
        done = subprocess.run(
            ["git", "-C", str(path.parent), *words], capture_output=True, text=True, check=False
        )
        described |= {key: done.stdout.strip()} if done.returncode == 0 else {}
    return described


def write_table(paths: list[Path], out: Path = TABLE_PATH) -> None:
    """Write the table of XML files, one message per line so that its changes are readable."""
    table = sorted(add_dialects({}, paths).items(), key=lambda item: item[1]["id"])
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(entry)}" for name, entry in table)
    sources = ",\n".join(json.dumps(describe_source(path)) for path in paths)
    out.write_text(f'{{"sources": [\n{sources}\n],\n"messages": {{\n{rows}\n}}}}\n')


if __name__ == "__main__":
    write_table([Path(name) for name in sys.argv[1:]])
