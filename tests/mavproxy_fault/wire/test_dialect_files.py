"""Dialects of the user, and what a fresh process makes of them."""

import json
import logging
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.dialect_files import (
    DIALECT_VARIABLE,
    add_dialects,
    find_recorded,
    read_dialect,
)

OWN = """<?xml version="1.0"?><mavlink><include>base.xml</include><messages>
<message id="60001" name="MY_MESSAGE"><description>own</description>
<field type="uint8_t" name="n" instance="true">number</field>
<field type="uint64_t" name="time_usec" units="us">time</field>
<field type="float" name="x" units="m">position</field><extensions/>
<field type="int16_t[3]" name="y">more</field></message></messages></mavlink>"""
BASE = """<?xml version="1.0"?><mavlink><include>own.xml</include><messages>
<message id="52950" name="BASE_ONE"><description>base</description>
<field type="uint8_t" name="a">a</field></message></messages></mavlink>"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "base.xml").write_text(BASE)
    (tmp_path / "own.xml").write_text(OWN)
    return tmp_path / "own.xml"


def test_a_file_and_its_includes_are_added(own: Path) -> None:
    table = add_dialects({}, [own])
    assert set(table) == {"MY_MESSAGE", "BASE_ONE"}
    mine = table["MY_MESSAGE"]
    assert (mine["id"], mine["instance"]) == (60001, "n")
    assert mine["fields"] == [
        ["time_usec", "uint64_t", 0, "us", False],
        ["x", "float", 0, "m", False],
        ["n", "uint8_t", 0, "", False],
        ["y", "int16_t", 3, "", True],
    ]


def test_pymavlink_knows_no_message_that_the_built_in_table_lacks() -> None:
    from pymavlink.dialects.v20 import all as judge

    for number, message in judge.mavlink_map.items():
        layout = message_layout(message.msgname)
        assert (layout.id, layout.crc_extra) == (number, message.crc_extra)
        by_id = "id" if "id" in message.fieldnames else ""
        assert layout.instance == (message.instance_field or by_id)
        types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
        theirs = [(name, types[name].replace("_mavlink_version", ""), count) for name, count in
                  zip(message.ordered_fieldnames, message.array_lengths, strict=True)]  # fmt: skip
        # MAVLink's own extension fields may be newer than pymavlink's.
        ours = [(one.name, one.type, one.count) for one in layout.fields.values()]
        assert ours[: len(theirs)] == theirs
        assert all(one.extension for one in list(layout.fields.values())[len(theirs) :])


def test_a_table_is_generated_from_files_and_names_them(own: Path, tmp_path: Path) -> None:
    script = runpy.run_path(str(Path(__file__).parents[3] / "docs" / "write_messages.py"))
    script["write_table"]([own], tmp_path / "table.json")
    table = json.loads((tmp_path / "table.json").read_text())
    assert table["messages"] == add_dialects({}, [own])
    (source,) = table["sources"]
    assert source == {"file": "own.xml", "sha256": read_dialect(own)[1]}
    own.with_name("base.xml").write_text(BASE.replace('name="a"', 'name="b"'))
    assert read_dialect(own)[1] != source["sha256"]  # an include counts


def test_the_longer_of_two_forms_with_one_checksum_is_used(own: Path) -> None:
    table = add_dialects({}, [own])
    short = own.with_name("short.xml")
    short.write_text(OWN.replace("<include>base.xml</include>", "").replace(
        '<extensions/>\n<field type="int16_t[3]" name="y">more</field>', ""))  # fmt: skip
    assert add_dialects(table, [short]) == table


def test_another_form_of_a_message_is_reported_and_needs_its_fields(
    own: Path, caplog: pytest.LogCaptureFixture
) -> None:
    table = add_dialects({}, [own])
    other = own.with_name("other.xml")
    more = 'a</field><field type="float" name="b">b</field>'
    other.write_text(BASE.replace("<include>own.xml</include>", "").replace("a</field>", more))
    assert len(add_dialects(table, [other])["BASE_ONE"]["fields"]) == 2
    assert "frames of the former BASE_ONE (id 52950" in caplog.text
    other.write_text(other.read_text().replace('name="a"', 'name="c"'))
    with pytest.raises(ConfigError, match="BASE_ONE lacks a of the message of that name"):
        add_dialects(table, [other])


def test_two_messages_with_one_id_are_reported(own: Path, caplog: pytest.LogCaptureFixture) -> None:
    other = own.with_name("other.xml")
    other.write_text(BASE.replace("BASE_ONE", "OTHER").replace("<include>own.xml</include>", ""))
    with caplog.at_level(logging.WARNING):
        table = add_dialects({}, [own, other])
    assert "OTHER" in table
    assert "BASE_ONE" not in table
    assert "message 52950 is OTHER and no longer BASE_ONE" in caplog.text


# pymavlink's generator leaves the file open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("text", ["<mavlink", "", "no XML", "<mavlink><include>x.xml</include>"])
def test_a_file_that_is_no_dialect_is_a_user_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(ConfigError, match=r"--dialect .*give a MAVLink XML file"):
        add_dialects({}, [tmp_path / "bad.xml"])


def command(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", *words],
        env={**os.environ, **variables}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_every_command_takes_dialects_by_option_and_variable(own: Path) -> None:
    for words, variables in (
        (["--dialect", str(own), "faults", "list", "--messages"], {}),
        (["faults", "list", "--messages", f"--dialect={own}"], {}),
        (["faults", "list", "--messages"], {DIALECT_VARIABLE: str(own)}),
    ):
        listed = command(*words, **variables).stdout.splitlines()
        assert "   60001  MY_MESSAGE" in listed
        assert "   52950  BASE_ONE" in listed
    assert command("faults", "list", "--dialect").returncode == 2


def test_every_message_of_a_file_is_a_target_and_is_in_the_report(own: Path) -> None:
    script = Path(__file__).with_name("every_message.py")
    own.with_name("base.xml").write_text(BASE.replace("<include>own.xml</include>", ""))
    done = subprocess.run(
        [sys.executable, str(script), str(own)], capture_output=True, text=True, check=False
    )
    assert done.stdout == "own.xml: 2 messages, 0 wrong\n", done.stdout + done.stderr


def test_a_recording_knows_the_dialect_it_was_made_with(own: Path, tmp_path: Path) -> None:
    recorder = "from pathlib import Path; from mavproxy_fault.app.recorder import Recorder; "
    recorder += f"Recorder(Path({str(tmp_path / 'run')!r}), {{}}).close(None, 0)"
    environment = {**os.environ, DIALECT_VARIABLE: str(own)}
    subprocess.run([sys.executable, "-c", recorder], env=environment, check=True)
    digest = read_dialect(own)[1]
    session = json.loads((tmp_path / "run" / "session.json").read_text())
    assert session["dialects"] == [{"file": str(own), "sha256": digest}]
    log = str(tmp_path / "run" / "received.tlog")
    assert find_recorded(["--out", log], []) == [str(own)]
    assert find_recorded([str(tmp_path / "run"), log], [str(own)]) == []


def test_a_changed_dialect_of_a_recording_is_named(
    own: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    digest = read_dialect(own)[1]
    session = {"dialects": [{"file": str(own), "sha256": digest}]}
    (tmp_path / "session.json").write_text(json.dumps(session))
    moved = tmp_path / "elsewhere" / "moved.xml"
    moved.parent.mkdir()
    for name in ("own.xml", "base.xml"):
        (moved.parent / name).write_text((tmp_path / name).read_text())
    moved = moved.with_name("own.xml")
    own.write_text(OWN.replace("60001", "60002"))
    assert find_recorded([str(tmp_path)], [str(moved)]) == []
    assert not caplog.records
    assert find_recorded([str(tmp_path)], []) == []
    assert f"recorded with {own}, which is missing or has changed" in caplog.text


def test_a_message_of_the_user_is_a_target_and_is_reported(own: Path, tmp_path: Path) -> None:
    extra = add_dialects({}, [own])["MY_MESSAGE"]["crc_extra"]
    log = b""
    for i in range(100):
        stamp = (1_000_000 + 20_000 * i).to_bytes(8, "little")
        payload = stamp + bytes(4) + b"\1"  # x is 0, n is 1
        body = bytes((len(payload), 0, 0, i, 1, 1)) + (60001).to_bytes(3, "little") + payload
        crc = mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")
        log += (10**15 + 20_000 * i).to_bytes(8, "big") + b"\xfd" + body + crc
    (tmp_path / "in.tlog").write_bytes(log)
    (tmp_path / "faults.yaml").write_text(
        "faults: [{fault: bias, target: MY_MESSAGE.x, value: 2.0, where: {id: 1}}]"
    )
    words = ["replay", "in.tlog", "--schedule", "faults.yaml", "--out", "out.tlog"]
    done = command(*(str(tmp_path / word) if "." in word else word for word in words),
                   **{DIALECT_VARIABLE: str(own)})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.tlog").read_bytes().count(b"\0\0\0\x40\1") == 100  # 2.0, then n
    assert '"magnitude":2.0' in (tmp_path / "out.labels.jsonl").read_text()
