"""What a ULog says in words: texts, PX4's events, and what the system printed before and after.

Since PX4 1.13 the vehicle tells events by a number and arguments; the log itself holds the words,
which pyulog puts together [1]_. Without them nothing is looked up elsewhere.

.. [1] MAVLink, Events Interface Protocol; PX4 User Guide, Events Interface.
"""

import contextlib
import io
from typing import Any

LoggedTexts = list[tuple[int, int, str]]  # t_us, severity as in MAVLink, text

LEVELS = ("EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING", "NOTICE", "INFO", "DEBUG")
DUPLICATE_US = 1_000_000  # within which a text and an event say the same
PRINTED_TITLES = {
    "boot_console_output": "Console",
    "perf_top_preflight": "Processes before the flight",
    "perf_top_postflight": "Processes after the flight",
    "perf_counter_preflight": "Performance counters before the flight",
    "perf_counter_postflight": "Performance counters after the flight",
    "hardfault_plain": "Hard fault",
}
MAX_CHARACTERS = 100_000  # of one printed text that are kept


def logged_texts(log: Any) -> LoggedTexts:
    """Texts and events of a `pyulog.ULog` in order; one that comes both ways comes once."""
    # The level is the character of a digit; one that is damaged must still be a severity.
    texts = [
        (m.timestamp, (m.log_level - ord("0")) & 7, m.message.strip()) for m in log.logged_messages
    ]
    new = [
        (t_us, severity, text)
        for t_us, severity, text in _events(log)
        if not any(
            abs(at_us - t_us) < DUPLICATE_US and said.endswith(text) for at_us, _, said in texts
        )
    ]
    return sorted(texts + new, key=lambda row: row[0])


def printed_texts(log: Any) -> dict[str, str]:
    """Printed texts by title."""
    found = {}
    for key, title in PRINTED_TITLES.items():
        lines = [line for part in log.msg_info_multiple_dict.get(key, ()) for line in part]
        # The console comes in pieces of lines, everything else line by line.
        between = "" if key == "boot_console_output" else "\n"
        text = between.join(line for line in lines if isinstance(line, str))
        if text.strip():
            found[title] = text[:MAX_CHARACTERS]
    return found


def _events(log: Any) -> LoggedTexts:
    from pyulog.px4_events import PX4Events

    reader = PX4Events()
    # Its own would download definitions.
    reader.set_default_json_definitions_cb(lambda _: None)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            found = reader.get_logged_events(log)
    except Exception:  # of a damaged log: it raises whatever its index code does
        return []
    return [
        (int(t_us), LEVELS.index(level), text.strip().rstrip(":"))
        for t_us, level, text in found
        if level in LEVELS and not text.startswith("[Unknown event")
    ]
