"""What a log says of the vehicle itself: firmware and version, board, UUID, frame.

ArduPilot says so in its first texts and in VER, PX4 in the information messages of a ULog; on a
link both send AUTOPILOT_VERSION.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from analysis.field_maps.autopilot_names import NAMES
from analysis.report.curves.recording import FlightData

FIRMWARE = re.compile(
    r"^((?:Ardu|APM|Blimp|Antenna)[\w:]* ?\w* ?[vV]\d[\w.\-]*(?: ?\([0-9a-f]+\))?)"
)
# The board's name and the three words of the processor's unique id.
BOARD = re.compile(r"^([\w.+-]+) ([0-9A-F]{8}) ([0-9A-F]{8}) ([0-9A-F]{8})$")
FRAME = re.compile(r"^Frame: (.+)$")
FRAMES = NAMES["frame"]
# FIRMWARE_VERSION_TYPE, from this number on.
RELEASES = ((255, ""), (192, " rc"), (128, " beta"), (64, " alpha"), (0, " dev"))


def version_text(number: int) -> str:
    """A version of four bytes: major, minor, patch and type of release."""
    major, minor, patch, kind = number.to_bytes(4, "big")
    return f"{major}.{minor}.{patch}" + next(text for least, text in RELEASES if kind >= least)


def identity_by_texts(texts: Iterable[str]) -> dict[str, str]:
    """What ArduPilot says of itself in its first texts."""
    found: dict[str, str] = {}
    for text in texts:
        if match := FIRMWARE.match(text):
            found.setdefault("firmware", match[1])
        elif match := BOARD.match(text):
            found.setdefault("board", match[1])
            found.setdefault("UUID", match[2] + match[3] + match[4])
        elif match := FRAME.match(text):
            found.setdefault("frame", match[1])
    return found


def identity_by_messages(flight: FlightData) -> dict[str, str]:
    """What the messages of a tlog or dataflash log say of the vehicle."""
    found = identity_by_texts(event.text for event in flight.events if event.kind == "text")
    beats, version = (flight.messages.get(name) for name in ("HEARTBEAT", "AUTOPILOT_VERSION"))
    if beats is not None and (frame := FRAMES.get(int(beats.columns["type"][-1]))):
        found.setdefault("frame", frame)
    if version is not None:
        last = {name: column[-1] for name, column in version.columns.items()}
        name = {"px4": "PX4", "ardupilot": "ArduPilot"}.get(flight.autopilot, "")
        commit = bytes(np.asarray(last["flight_custom_version"], np.uint8)).rstrip(b"\0")
        words = [name, version_text(int(last["flight_sw_version"]))]
        # ArduPilot sends the characters of the hash, PX4 its bytes in reverse.
        words += [f"({commit.decode()})" if commit.isalnum() else f"({commit[::-1].hex()})"]
        found.setdefault("firmware", " ".join(filter(None, words)))
        if last["uid"]:
            found.setdefault("UUID", f"{int(last['uid']):016X}")
    said = flight.messages.get("VER")
    if said is not None and "FWS" in said.columns:
        found["firmware"] = bytes(said.columns["FWS"][-1]).decode("utf-8", "replace").strip("\0 ")
    return found


def identity_by_info(info: Mapping[str, Any], parameters: Mapping[str, float]) -> dict[str, str]:
    """What the information messages and parameters of a ULog say of the vehicle."""
    release, branch = info.get("ver_sw_release"), str(info.get("ver_sw_branch", ""))
    words = [
        str(info.get("sys_name", "PX4")),
        version_text(release) if isinstance(release, int) and release else branch,
        f"({str(info.get('ver_sw', ''))[:8]})",
    ]
    frame = FRAMES.get(int(parameters.get("MAV_TYPE", 0)), "")
    airframe = int(parameters.get("SYS_AUTOSTART", 0))
    found = {
        "firmware": " ".join(word for word in words if word.strip("()")),
        "board": str(info.get("ver_hw", "")),
        "UUID": str(info.get("sys_uuid", "")),
        "frame": ", ".join(filter(None, [frame, f"airframe {airframe}" if airframe else ""])),
    }
    return {name: text for name, text in found.items() if text}
