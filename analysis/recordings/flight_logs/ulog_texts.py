"""Texts of a ULog: log messages, PX4 events, and console output before and after the flight.

Since PX4 1.13 an event is logged as a number with arguments; pyulog builds its text from the
definitions in the log [1]_. A log without definitions gives no event texts.

.. [1] MAVLink, Events Interface Protocol; PX4 User Guide, Events Interface.
"""

import contextlib
import io
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from numpy.typing import NDArray

from analysis.recordings.flight_logs.autopilot_log import LoggedTexts

LEVELS = ("EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING", "NOTICE", "INFO", "DEBUG")
DUPLICATE_US = 1_000_000  # a text and an event this close with equal wording are one
PRINTED_TITLES = {
    "boot_console_output": "Console",
    "perf_top_preflight": "Processes before the flight",
    "perf_top_postflight": "Processes after the flight",
    "perf_counter_preflight": "Performance counters before the flight",
    "perf_counter_postflight": "Performance counters after the flight",
    "hardfault_plain": "Hard fault",
}
MAX_CHARACTERS = 100_000  # kept of one printed text


def logged_texts(
    texts: LoggedTexts,
    events: Mapping[str, NDArray[Any]],
    info: Mapping[str, Any],
    several: Mapping[str, list[list[Any]]],
) -> LoggedTexts:
    """Texts and events of a log in order of time, without duplicates.

    `events` are the columns of the topic `event`; `info` and `several` the information messages,
    with the definitions of the events.
    """
    # What pyulog needs to read events.
    log = SimpleNamespace(
        get_dataset=lambda _: SimpleNamespace(data=events),
        msg_info_multiple_dict=several, msg_info_dict=info,
    )  # fmt: skip
    new = [
        (t_us, severity, text)
        for t_us, severity, text in _events(log)
        if not any(
            abs(at_us - t_us) < DUPLICATE_US and said.endswith(text) for at_us, _, said in texts
        )
    ]
    return sorted(texts + new, key=lambda row: row[0])


def printed_texts(several: Mapping[str, list[list[Any]]]) -> dict[str, str]:
    """Console and diagnostic output by title."""
    found = {}
    for key, title in PRINTED_TITLES.items():
        lines = [line for part in several.get(key, ()) for line in part]
        # The console output is split anywhere, everything else at line ends.
        between = "" if key == "boot_console_output" else "\n"
        text = between.join(line for line in lines if isinstance(line, str))
        if text.strip():
            found[title] = text[:MAX_CHARACTERS]
    return found


def _events(log: SimpleNamespace) -> LoggedTexts:
    from pyulog.px4_events import PX4Events

    reader = PX4Events()
    # The default callback would download definitions.
    reader.set_default_json_definitions_cb(lambda _: None)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = reader.get_logged_events(log)
    except Exception:  # pyulog raises any type of error on a corrupted log
        return []
    return [
        (int(t_us), LEVELS.index(level), text.strip().rstrip(":"))
        for t_us, level, text in found
        if level in LEVELS and not text.startswith("[Unknown event")
    ]
