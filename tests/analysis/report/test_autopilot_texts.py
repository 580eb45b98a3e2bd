"""Texts are judged by their source, severity and version, not by words alone."""

import numpy as np
import pytest

from analysis.report.curves.recording import UNGRADED, Event, FlightData
from analysis.report.judging.autopilot_texts import texts_check
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.report.recordings.text_severities import has_old_severities
from mavproxy_fault.wire.tlog import Columns, row_dtype


def verdict(*texts: tuple[int, str]) -> str:
    events = [Event(float(i), "text", text, severity) for i, (severity, text) in enumerate(texts)]
    return texts_check(FlightData("x", events=events), None).verdict


@pytest.mark.parametrize(
    ("severity", "text", "right"),
    [
        (6, "PrecLand: Failsafe Measures", "PASS"),
        (UNGRADED, "PrecLand: Failsafe Measures", "PASS"),
        (UNGRADED, "AutoTune: Failed", "PASS"),
        (UNGRADED, "Terminating due to RC loss", "FAIL"),
        (6, "Crash check disabled", "PASS"),
        (4, "Crash check disabled", "PASS"),
        (5, "Failsafe: continuing mission", "WARN"),
        (4, "Radio Failsafe", "FAIL"),
        (0, "Crash: Disarming", "FAIL"),
        # ArduPilot's simulator reports every landing as information.
        (6, "SIM Hit ground at 0.4 m/s", "PASS"),
        (6, "SIM Hit ground at 9.3 m/s", "FAIL"),
        (UNGRADED, "SIM Hit ground at 9.3 m/s", "FAIL"),
        (UNGRADED, "SIM Hit ground at 0.4 m/s", "PASS"),
        (6, "Parachute: Released", "FAIL"),
    ],
)
def test_a_text_is_judged_by_severity_and_meaning(severity: int, text: str, right: str) -> None:
    assert verdict((severity, text)) == right


@pytest.mark.parametrize(
    ("texts", "old"),
    [
        ([(1, "Reached Command #1")], True),
        ([(1, "Initialising APM..."), (3, "Low Battery!")], True),
        ([(3, "APM:Copter V3.2.1 (36b405fb)"), (1, "x")], True),
        ([(6, "ArduCopter V4.5.7 (2a3dc4b7)"), (1, "Reached Command #1")], False),
        ([(1, "Crash: Disarming")], False),
    ],
)
def test_severities_of_2014_are_recognised(texts: list[tuple[int, str]], old: bool) -> None:
    assert has_old_severities(texts) == old


def tlog_columns(*texts: tuple[int, int, int, int, bytes]) -> Columns:
    """Rows of STATUSTEXT (component, severity, id, chunk, text), with a copter's heartbeats."""
    rows = np.zeros(len(texts), row_dtype("STATUSTEXT"))
    for i, (component, severity, number, chunk, text) in enumerate(texts):
        rows[i]["t_us"], rows[i]["system"], rows[i]["component"] = i * 100_000, 1, component
        rows[i]["severity"], rows[i]["id"], rows[i]["chunk_seq"] = severity, number, chunk
        rows[i]["text"] = text
    beats = np.zeros(20, row_dtype("HEARTBEAT"))
    beats["t_us"], beats["system"], beats["component"] = np.arange(20) * 100_000, 1, 1
    beats["type"], beats["autopilot"], beats["base_mode"] = 2, 3, 0x80
    ticks = np.zeros(20, row_dtype("ATTITUDE"))
    ticks["t_us"], ticks["system"], ticks["component"] = np.arange(20) * 100_000, 1, 1
    ticks["time_boot_ms"] = 1000 + np.arange(20) * 100
    return {"STATUSTEXT": rows, "HEARTBEAT": beats, "ATTITUDE": ticks}


def test_the_chunks_of_a_long_text_are_one_text() -> None:
    columns = tlog_columns(
        (1, 4, 7, 0, b"a text of more than fifty characters, which ends w"),
        (1, 4, 7, 1, b"ith this"),
        (1, 4, 0, 0, b"short"),
    )
    texts = [event.text for event in recording_of_tlog(columns).events if event.kind == "text"]
    assert texts == ["a text of more than fifty characters, which ends with this", "short"]


def test_what_a_companion_says_is_shown_and_judges_no_flight() -> None:
    found = recording_of_tlog(tlog_columns((191, 2, 0, 0, b"camera failure"), (1, 6, 0, 0, b"ok")))
    assert "camera failure (component 191)" in [event.text for event in found.events]
    assert texts_check(found, None).verdict == "PASS"
