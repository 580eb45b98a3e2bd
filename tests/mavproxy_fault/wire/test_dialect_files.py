"""Dialects of the user, and what a fresh process makes of them."""

import logging
import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from fastcrc.crc16 import mcrf4xx

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import DIALECT_VARIABLE
from mavproxy_fault.wire.dialect_files import add_dialects
from mavproxy_fault.wire.generate_messages import build_message_table

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


def test_the_files_of_pymavlink_give_its_own_table() -> None:
    path = Path(str(files("pymavlink.dialects.v20") / "common.xml"))
    table, built_in = add_dialects({}, [path]), build_message_table()
    assert len(table) > 200
    for name, entry in table.items():
        assert {**entry, "fields": None} == {**built_in[name], "fields": None}
        typed = [[field.replace("_mavlink_version", "") if isinstance(field, str) else field
                  for field in row] for row in built_in[name]["fields"]]  # fmt: skip
        assert entry["fields"] == typed, name


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
