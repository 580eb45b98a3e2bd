"""Onsets of faults: seconds, phases of flight, flight events, and conditions on telemetry."""

import re
from typing import Any

from mavproxy_fault.schedule.triggers import FLIGHT_EVENTS, Condition, event_condition

BARE_MODE = re.compile(r"\b(mode\s*[!=]=\s*)([A-Z][\w.]*)")
PHASES = ("hover", "turn", "climb", "descent", "level", "landing")


def onset_keys(onset: float | str) -> dict[str, Any]:
    """Return the keys of a schedule's entry for an onset: seconds, a flight event, or a condition
    such as `mode == AUTO.RTL`; none for a phase, whose time is that of the reference flight.

    Raises
    ------
    ValueError
        If the onset is none of these.
    """
    if not isinstance(onset, str):
        return {"at_s": onset}
    if onset in PHASES:
        return {}
    try:
        if event_condition(onset) is not None:
            return {"from": onset, "at_s": 0.0}
    except ValueError:
        pass
    try:
        # Names of modes need no quotes in a campaign.
        when = BARE_MODE.sub(r'\1"\2"', onset)
        Condition(when)
    except ValueError as error:
        events = ", ".join((*FLIGHT_EVENTS, "mission-item:N"))
        raise ValueError(
            f"onsets: {onset} {error}; give seconds, a phase ({', '.join(PHASES)}), a flight event "
            f"({events}), or a condition as in a schedule"
        ) from None
    return {"when": when, "at_s": 0.0}
