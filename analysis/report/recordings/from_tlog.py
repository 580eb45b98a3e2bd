"""Convert the MAVLink messages of one or more tlogs of one flight to `FlightData`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.field_map import TLOG
from analysis.recordings.flight_logs.log_stamps import (
    GROUND_STATION,
    WALL_US,
    autopilot_beats,
    autopilot_component,
)
from analysis.recordings.flight_logs.message_clock import LogClock, clock_of
from analysis.report.curves.recording import Event, FlightData, Message, local_track, value_spans
from analysis.report.curves.vehicle_phase import ARDUPILOT, CLASSES, PX4, mode_name
from analysis.report.recordings.link_quality import link_quality
from analysis.report.recordings.mapped_message import add_message, mode_events
from analysis.report.recordings.text_severities import OLD_SEVERITIES, has_old_severities
from analysis.report.recordings.vehicle_identity import identity_by_messages
from mavproxy_fault.wire.tlog import Columns

ARMED = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
HEADER = ("t_us", "system", "component", "seq")  # columns that are not fields of the message
TRUTH = "HIL_STATE_QUATERNION"
# Messages from which a report has curves.
CRITICAL, TERMINATED = {5: "CRITICAL", 6: "EMERGENCY"}, 8  # MAV_STATE
SHOWN = {name for name, lines in TLOG.items() if any(line.is_curve for line in lines)}
TURNING_RPS = 0.05  # chosen: a larger range of a gyroscope means rotation
SET_MODE = 176  # MAV_CMD_DO_SET_MODE
SIMULATOR = 51  # component of a HIL simulator
# Bits of SYS_STATUS whose changes ArduPilot's own log has as errors, by their words there
HEALTH = {4: "compass", 8: "barometer"}  # MAV_SYS_STATUS_SENSOR_3D_MAG, _ABSOLUTE_PRESSURE
UNHEALTHY = "error 4"
MODE_COMMANDS = {
    20: "RTL", 21: "LAND", 22: "TAKEOFF", 84: "TAKEOFF", 85: "LAND", 192: "reposition",
    193: "pause", 300: "mission",
}  # MAV_CMD_  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Vehicle:
    """One vehicle's rows, and the suffix of its signals if there are several vehicles.

    `columns` are the autopilot's; `others` are rows of messages that companions, cameras or
    gimbals of the same system send too.
    """

    system: int
    columns: Columns
    others: Columns
    clock: LogClock
    suffix: str
    autopilot: int
    kind: str


def merge_logs(logs: Sequence[Columns]) -> Columns:
    """Merge the columns of several logs of one flight, in order of their timestamps."""
    if len(logs) == 1:
        return logs[0]
    names = dict.fromkeys(name for columns in logs for name in columns)
    together = {}
    for name in names:
        rows = np.concatenate([columns[name] for columns in logs if name in columns])
        # Stable: rows with equal timestamps keep the order of their logs.
        together[name] = rows[np.argsort(rows["t_us"], kind="stable")]
    return together


def recording_of_tlog(
    columns: Columns,
    *,
    name: str = "",
    t0_us: int | None = None,
    links: Mapping[str, NDArray[np.void]] | None = None,
) -> FlightData:
    """Convert the messages of all vehicles in a log to the data of a report.

    `columns` are as `mavproxy_fault.wire.tlog.read_columns` gives them (several logs:
    `merge_logs`); `t0_us` is the vehicle time of zero on the axis (a label's `t0_us`), the start by
    default; `links` are rows of `link_quality.sum_stretches` (k,) by log name.
    """
    systems = vehicle_systems(columns)
    found = FlightData(name)
    vehicles = []
    # Without a vehicle all messages are shown as one.
    for system in systems or [0]:
        own = {key: rows[rows["system"] == system] for key, rows in columns.items()}
        # A log without vehicles is used entirely.
        own = {key: rows for key, rows in own.items() if len(rows)} if systems else columns
        own, warnings = _without_placeholder(own)
        clock, notes = clock_of(own, t0_us)
        notes += warnings
        found.notes.extend(notes)
        # A single vehicle's curves need no suffix.
        suffix = f" (system {system})" if len(systems) > 1 else ""
        vehicles.append(_Vehicle(system, *_by_component(own), clock, suffix, *_kind(own)))
    for vehicle in vehicles:
        _add_vehicle(found, vehicle)
        found.events.extend(_commanded_modes(columns, vehicle))
    found.events.extend(mode_events(found.spans))
    armed = [(s.start_s, s.end_s) for s in found.spans if s.text == "armed"]
    quality, losses = link_quality(links or {}, vehicles[0].clock, armed)
    found.links.extend(quality)
    found.signals.extend(losses)
    # The first vehicle determines the autopilot.
    first = vehicles[0]
    found.events.sort(key=lambda event: event.t_s)
    flight = replace(
        found, autopilot={PX4: "px4", ARDUPILOT: "ardupilot"}.get(first.autopilot, ""),
        t0_us=int(first.clock.t0_us), systems=tuple(systems), vehicle=first.kind,
        duration_s=max((s.t_s[-1] for s in found.signals if len(s.t_s)), default=0.0),
        utc0_us=_utc0_us(columns, first.clock),
    )  # fmt: skip
    return replace(flight, identity=identity_by_messages(flight))


def _by_component(columns: Columns) -> tuple[Columns, Columns]:
    """Rows of the autopilot, and those of other components in messages that both send."""
    component = autopilot_component(columns)
    own, others = {}, {}
    for name, rows in columns.items():
        mine = rows["component"] == component
        # What only others send is of the vehicle too: simulated sensors, a radio.
        own[name] = rows[mine] if mine.any() and name != "STATUSTEXT" else rows
        if len(own[name]) < len(rows):
            others[name] = rows[~mine]
    return own, others


def _utc0_us(columns: Columns, clock: LogClock) -> int:
    """UTC at zero on the axis in us; 0 if the timestamps are not Unix time."""
    first = min((int(rows["t_us"].min()) for rows in columns.values()), default=0)
    # Small timestamps count from boot.
    if first < WALL_US:
        return 0
    return round(first - float(clock.at(np.array([first]))[0]) * 1e6)


def _without_placeholder(columns: Columns) -> tuple[Columns, list[str]]:
    """Remove a constant truth, which simulators without a truth send; returns columns and notes."""
    rows = columns.get(TRUTH)
    if rows is None or len(rows) < 2 or "HIL_SENSOR" not in columns:
        return columns, []
    same = all(
        np.all(rows[name] == rows[name][0]) for name in ("attitude_quaternion", "lat", "alt")
    )
    # A vehicle at rest has a constant truth too.
    turning = np.ptp(columns["HIL_SENSOR"]["xgyro"]) > TURNING_RPS
    if not (same and turning):
        return columns, []
    kept = {name: rows for name, rows in columns.items() if name != TRUTH}
    return kept, [f"{TRUTH} never changes while the gyroscopes show rotation: it is ignored"]


def vehicle_systems(columns: Columns) -> list[int]:
    """System ids of vehicles: senders of plotted messages, except ground stations and radios."""
    systems: set[int] = set()
    for message in SHOWN & columns.keys():
        systems.update(np.unique(columns[message]["system"]).tolist())
    if "HEARTBEAT" in columns:
        beats = columns["HEARTBEAT"]
        station = beats["type"] == GROUND_STATION
        flying = set(beats["system"][~station].tolist())
        # A system that also sends a vehicle's heartbeat is kept.
        systems -= set(beats["system"][station].tolist()) - flying
        # Systems without a heartbeat, such as telemetry radios.
        systems &= flying if flying & systems else systems
    return sorted(systems)


def _kind(columns: Columns) -> tuple[int, str]:
    """Autopilot and class of the vehicle from the autopilot's heartbeats."""
    beats = autopilot_beats(columns)
    # The last heartbeat, as the type may be known late.
    return next(
        ((int(beat["autopilot"]), CLASSES.get(int(beat["type"]), "")) for beat in beats[-1:]),
        (0, ""),
    )


def _add_vehicle(found: FlightData, vehicle: _Vehicle) -> None:
    messages = {
        name: _message(vehicle, rows) for name, rows in vehicle.columns.items() if len(rows)
    }
    ending = f"_{vehicle.system}" if vehicle.suffix else ""
    found.messages.update({f"{name}{ending}": message for name, message in messages.items()})
    for name, rows in vehicle.others.items():
        for component in np.unique(rows["component"]).tolist():
            some = _message(vehicle, rows[rows["component"] == component])
            found.messages[f"{name}{ending}_component_{component}"] = some
    for name, lines in TLOG.items():
        if name in messages:
            add_message(found, lines, messages[name], vehicle.suffix)
    _add_local_track(found, vehicle, messages.get("LOCAL_POSITION_NED"))
    _add_modes(found, vehicle)
    _add_texts(found, vehicle)
    if vehicle.autopilot == ARDUPILOT:
        _add_health(found, vehicle)
    _add_parameters(found, vehicle)


def _message(vehicle: _Vehicle, rows: NDArray[np.void]) -> Message:
    """The rows of a message as columns, in order of the vehicle's time."""
    t_s = vehicle.clock.seconds(rows)
    # Frames may have been logged out of order.
    if not np.all(np.diff(t_s) >= 0):
        order = np.argsort(t_s, kind="stable")
        t_s, rows = t_s[order], rows[order]
    names = rows.dtype.names or ()
    return Message(t_s, {name: rows[name] for name in names if name not in HEADER})


def _commanded_modes(columns: Columns, vehicle: _Vehicle) -> list[Event]:
    """The commands to a vehicle that change its mode; none where a remote control may change it."""
    remote = vehicle.columns.get("RC_CHANNELS")
    # That of a simulator has sticks only.
    if remote is not None and remote["chancount"][remote["component"] != SIMULATOR].any():
        return []
    found = []
    for message in ("COMMAND_LONG", "COMMAND_INT", "SET_MODE"):
        rows = columns.get(message)
        if rows is None:
            continue
        rows = rows[np.isin(rows["target_system"], (0, vehicle.system))]
        for t_s, row in zip(vehicle.clock.at(rows["t_us"]).tolist(), rows, strict=True):
            text = _commanded_mode(row, vehicle)
            if text:
                found.append(Event(t_s, "command", text + vehicle.suffix))
    return found


def _commanded_mode(row: np.void, vehicle: _Vehicle) -> str:
    """The mode that a command asks for, empty for commands about something else."""
    if "custom_mode" in (row.dtype.names or ()):
        return mode_name(vehicle.autopilot, vehicle.kind, int(row["custom_mode"]))
    command = int(row["command"])
    if command != SET_MODE:
        return MODE_COMMANDS.get(command, "")
    # PX4 takes main mode and sub-mode apart.
    main, sub = (int(np.nan_to_num(row[name])) for name in ("param2", "param3"))
    custom = main << 16 | sub << 24 if vehicle.autopilot == PX4 else main
    return mode_name(vehicle.autopilot, vehicle.kind, custom)


def _add_local_track(found: FlightData, vehicle: _Vehicle, message: Message | None) -> None:
    """Add the local position as a track, only without a global one, as indoors."""
    if message is not None and len(message.t_s) > 1 and not found.tracks:
        ned = (message.columns[axis] for axis in "xyz")
        found.tracks.append(local_track("local estimate" + vehicle.suffix, message.t_s, *ned))


def _add_modes(found: FlightData, vehicle: _Vehicle) -> None:
    beats = autopilot_beats(vehicle.columns)
    if not len(beats):
        return
    kind = vehicle.autopilot, vehicle.kind
    modes = [mode_name(*kind, mode) for mode in beats["custom_mode"].tolist()]
    # Only CRITICAL and EMERGENCY have a name; other states make no span.
    lanes = (
        # PX4 still sends the mode that was set when it terminates the flight.
        ("mode", np.where(beats["system_status"] == TERMINATED, "TERMINATION", modes), "mode"),
        ("armed", np.where(beats["base_mode"] & ARMED, "armed", "disarmed"), "mode"),
        ("system status", [CRITICAL.get(n, "") for n in beats["system_status"].tolist()], "fail"),
    )
    for lane, words, shown in lanes:
        t_s = vehicle.clock.seconds(beats)
        found.spans.extend(value_spans(lane + vehicle.suffix, t_s, words, shown))


def _add_texts(found: FlightData, vehicle: _Vehicle) -> None:
    rows = vehicle.columns.get("STATUSTEXT")
    if rows is None:
        return
    component = autopilot_component(vehicle.columns)
    # STATUSTEXT has no time field: use the log's timestamp.
    spoken = [
        (t_s, int(row["component"]), int(row["severity"]), text)
        for t_s, row, text in _joined_texts(vehicle.clock.at(rows["t_us"]).tolist(), rows)
    ]
    own = [(severity, text) for _, by, severity, text in spoken if by == component]
    old = vehicle.autopilot == ARDUPILOT and has_old_severities(own)
    for t_s, by, severity, text in spoken:
        others = component >= 0 and by != component
        said = text + (f" (component {by})" if others else "") + vehicle.suffix
        graded = OLD_SEVERITIES.get(severity, severity) if old and not others else severity
        # What a companion or a gimbal says is shown, and judges no flight.
        found.events.append(Event(t_s, "note" if others else "text", said, graded))


def _add_health(found: FlightData, vehicle: _Vehicle) -> None:
    """Add sensors that ArduPilot no longer finds healthy, and does again, as its own `ERR` does."""
    rows = vehicle.columns.get("SYS_STATUS")
    if rows is None:
        return
    enabled, healthy = (rows[f"onboard_control_sensors_{it}"] for it in ("enabled", "health"))
    t_s = vehicle.clock.seconds(rows)
    for bit, sensor in HEALTH.items():
        bad = (enabled & ~healthy & np.bitwise_or.accumulate(healthy) & bit) != 0
        for at in np.flatnonzero(np.diff(bad, prepend=False)).tolist():
            text = f"{sensor}: {UNHEALTHY if bad[at] else 'resolved'}{vehicle.suffix}"
            found.events.append(Event(float(t_s[at]), "error", text, 3 if bad[at] else 6))


def _joined_texts(
    t_s: Sequence[float], rows: NDArray[np.void]
) -> Iterator[tuple[float, NDArray[np.void], str]]:
    """Time, row and text of each message; the chunks of a long text (same id) are one text."""
    chunked = {"chunk_seq", "id"} <= set(rows.dtype.names or ())
    begun: dict[tuple[int, ...], list[bytes]] = {}
    texts: list[tuple[float, NDArray[np.void], list[bytes]]] = []
    for at_s, row in zip(t_s, rows, strict=True):
        part = bytes(row["text"]).split(b"\0", 1)[0]
        key = (int(row["system"]), int(row["component"]), int(row["id"]) if chunked else 0)
        # An id of zero means a text of one chunk.
        if key[2] and row["chunk_seq"] and key in begun:
            begun[key].append(part)
            continue
        begun[key] = [part]
        texts.append((at_s, row, begun[key]))
    for at_s, row, parts in texts:
        yield at_s, row, b"".join(parts).decode("utf-8", "replace").strip()


def _add_parameters(found: FlightData, vehicle: _Vehicle) -> None:
    rows = vehicle.columns.get("PARAM_VALUE")
    if rows is None:
        return
    t_s = vehicle.clock.at(rows["t_us"])
    for i, row in enumerate(rows):
        name = bytes(row["param_id"]).split(b"\0", 1)[0].decode("ascii", "replace")
        value = float(row["param_value"])
        if vehicle.autopilot == PX4 and row["param_type"] == 6:  # the bytes of an int32
            value = float(row["param_value"].view(np.int32))
        found.add_parameter(name + vehicle.suffix, float(t_s[i]), value)
