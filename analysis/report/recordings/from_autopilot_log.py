"""Convert a ULog or an ArduPilot dataflash log to `FlightData`.

Messages and fields are named as in the autopilots' definitions (old logs: as then). What only one
autopilot logs is in `px4_parts` and `ardupilot_parts`.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from analysis.field_maps.field_map import DATAFLASH, GATES, ULOG
from analysis.recordings.flight_logs.autopilot_log import AutopilotLog
from analysis.report.curves.recording import Event, FlightData, Message
from analysis.report.curves.vehicle_phase import COPTER, MODES
from analysis.report.recordings.ardupilot_parts import add_ardupilot_parts, ardupilot_class
from analysis.report.recordings.mapped_message import add_message, mode_events
from analysis.report.recordings.px4_parts import add_px4_parts, px4_class
from analysis.report.recordings.vehicle_identity import identity_by_info, identity_by_messages


def recording_of_log(log: AutopilotLog, name: str, t0_us: int | None = None) -> FlightData:
    """Convert a log; the time axis starts at `t0_us` or the log's start."""
    start_us = log.start_us if t0_us is None else t0_us
    px4 = log.autopilot == "px4"
    vehicle, table = (px4_class(log), ULOG) if px4 else (ardupilot_class(log), DATAFLASH)
    found = FlightData(
        name, log.autopilot, start_us, (log.end_us - start_us) * 1e-6, vehicle=vehicle,
        notes=log.notes(), defaults=log.defaults, printed=log.printed,
    )  # fmt: skip
    modes = MODES.get(vehicle, MODES[COPTER])
    # Older versions of PX4 have no field `connected`.
    constants: dict[str, Any] = {**GATES, **log.parameters, "connected": 1.0, "MODES": modes}
    for (kind, instance), topic in sorted(log.topics.items()):
        t_s = np.asarray((topic[log.stamp].astype(np.int64) - start_us) * 1e-6)
        suffix = f" {instance + 1}" if instance else ""
        # Names in the page's expressions cannot contain spaces.
        message = found.messages[f"{kind}{suffix.replace(' ', '_')}"] = Message(t_s, topic)
        lines = [line for line in table.get(kind, ()) if not (line.first and instance)]
        add_message(found, lines, message, suffix, constants)
    for t_us, severity, text in log.messages:
        found.events.append(Event((t_us - start_us) * 1e-6, "text", text, severity))
    initial = [(start_us, parameter, value) for parameter, value in log.parameters.items()]
    for t_us, parameter, value in [*initial, *log.changes]:
        found.add_parameter(parameter, (t_us - start_us) * 1e-6, value)
    utc0_us = (add_px4_parts if px4 else add_ardupilot_parts)(found)
    found.events.extend(mode_events(found.spans))
    found.events.sort(key=lambda event: event.t_s)
    identity = identity_by_info(log.info, log.parameters) if px4 else identity_by_messages(found)
    return replace(found, utc0_us=utc0_us, identity=identity)
