"""Which channels of the monitor can observe a fault, and what they may correctly isolate.

A *channel* is what one test of the monitor covers: the satellites, the receiver's own position and
velocity, the IMU, another sensor, the link. The targets of a fault determine what it falsifies;
without targets its kind does.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from analysis.detection.detector_registry import other_detectors
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.plant_names import COMPASS

SATELLITES, POSITION, VELOCITY = "satellites", "gps-position", "gps-velocity"
IMU, MAG, BARO, AIRSPEED, RANGE, VISION, LINK = (
    *("imu", "mag", "baro", "airspeed", "range", "vision", "link"),
)
ACTUATORS = "actuators"
# Names under which a receiver is isolated.
RECEIVER_NAMES = frozenset({POSITION, VELOCITY, "GPS", "clock"})
RECEIVER_CHANNELS = frozenset({SATELLITES, POSITION, VELOCITY})
EVERY_SATELLITE = "every satellite"
GROUND_STATIONS = (255, 245)  # QGroundControl, MAVProxy and the operator of a run; MAVSDK
SATELLITE = re.compile(r"[GRECJSI]\d\d")


class FaultVisibility(NamedTuple):
    """Which channels can observe a fault, and what they should isolate.

    `channels` can observe it; one name of each set in `must_isolate` must be isolated, and every
    name in `may_isolate` is a correct isolation. Without channels `reason` says why.
    """

    channels: frozenset[str]
    must_isolate: tuple[frozenset[str], ...] = ()
    may_isolate: frozenset[str] = frozenset()
    reason: str = ""

    def allows(self, name: str) -> bool:
        """Whether isolating a name is correct."""
        # For a fault of all satellites any of them is correct.
        if EVERY_SATELLITE in self.may_isolate and SATELLITE.fullmatch(name):
            return True
        return name in self.may_isolate


def _sensor(name: str) -> FaultVisibility:
    own = frozenset({name})
    return FaultVisibility(own, (own,), own)


def _any_of(*parts: FaultVisibility) -> FaultVisibility:
    """One source of all of these: isolating any of them is enough."""
    names = frozenset().union(*(part.may_isolate for part in parts))
    return FaultVisibility(frozenset().union(*(part.channels for part in parts)), (names,), names)


# Epochs and fixes are tested against the IMU: their alarm may be caused by the IMU.
IMU_VISIBILITY = FaultVisibility(
    frozenset({IMU, SATELLITES, POSITION}), (frozenset({IMU}),), frozenset({IMU})
)
FIX_VISIBILITY = FaultVisibility(frozenset({POSITION, VELOCITY}), (RECEIVER_NAMES,), RECEIVER_NAMES)
# As a name "satellites" is the stream of raw ranges, which can fall silent.
ENTIRE_RECEIVER = RECEIVER_NAMES | {SATELLITES, EVERY_SATELLITE}
RECEIVER_VISIBILITY = FaultVisibility(RECEIVER_CHANNELS, (ENTIRE_RECEIVER,), ENTIRE_RECEIVER)
SENSOR_VISIBILITY = {name: _sensor(name) for name in (MAG, BARO, AIRSPEED, RANGE, VISION, LINK)}
SENSOR_VISIBILITY |= {IMU: IMU_VISIBILITY}

# What the outputs of HIL_ACTUATOR_CONTROLS, from 0, drive: a multirotor's motors in order, and on a
# fixed wing these. A plane has no motor 5, and a hexarotor no throttle.
OUTPUTS = 16
NO_PARAMETERS: Mapping[str, object] = {}
PLANE_OUTPUTS = {2: "rudder", 4: "throttle", 5: "aileron", 6: "aileron", 7: "elevator"}
MOTOR = re.compile(r"(motor|propeller)_efficiency\[(\d+)\]")
SENSOR_PLANT_FAULTS = {  # what a plant fault that acts on sensors falsifies
    **dict.fromkeys(("rotor_unbalance_kgm", "thrust_ripple"), (IMU,)),
    **dict.fromkeys(COMPASS, (MAG,)),
    "sensor_warming_k": (IMU, BARO, AIRSPEED),
}
SURFACE = re.compile(r"(elevator|aileron|rudder)_efficiency")

SENSOR_FIELDS = {
    IMU: re.compile(r"[xyz](gyro|acc)"), MAG: re.compile(r"[xyz]mag"),
    BARO: re.compile(r"abs_pressure|press_abs|pressure_alt"),
    AIRSPEED: re.compile(r"diff_pressure|press_diff"),
}  # fmt: skip
SENSOR_MESSAGES = {
    **dict.fromkeys(("HIL_SENSOR", "HIGHRES_IMU"), (IMU, MAG, BARO, AIRSPEED)),
    **dict.fromkeys(("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"), (IMU, MAG)),
    **dict.fromkeys(
        ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3", "RAW_PRESSURE"),
        (BARO, AIRSPEED),
    ),
    "DISTANCE_SENSOR": (RANGE,),
    **dict.fromkeys(("ODOMETRY", "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE"), (VISION,)),
}
FIX_MESSAGES = ("HIL_GPS", "GPS_RAW_INT", "GPS2_RAW", "GPS_INPUT", "GLOBAL_POSITION_INT")
SENSOR_GROUPS = {"accel": IMU, "gyro": IMU, "mag": MAG, "baro": BARO, "airspeed": AIRSPEED}
# Faults that act on the link's bytes and frames, whatever their content
LOSS_FAULTS = (
    *("outage", "drop", "burst-loss", "gilbert-elliott", "rate-limit", "corrupt", "truncate"),
    *("sequence-gap", "bit-errors", "radio", "four-state-loss"),
)
LATE_FAULTS = ("delay", "jitter", "slots")  # a stream is silent while its frames are late
LINK_UNITS = ("mavlink-", "datalink-")  # failures of the autopilot's own link
HARMLESS_FAULTS = {  # no channel should react to these
    "command": "a command to the vehicle falsifies nothing",
    "duplicate": "a repeated frame is unchanged",
    "slice": "the frames arrive whole",
}
RECEIVER_PLANT_FAULT = re.compile(
    r"receiver_off|(cn0_drop_db|pseudorange_m|range_rate_mps|satellite_lost|spoof_\w+)\[\w+\]"
)


def fault_visibility(label: Label) -> FaultVisibility:
    """Which channels can see the fault of a label, those of other packages' detectors included."""
    known = _own_visibility(label)
    if label.fault in HARMLESS_FAULTS:
        return known
    names = known.channels.union(label.targets, (t.partition(".")[0] for t in label.targets))
    others = [kind.channels for kind in other_detectors().values() if kind.sees & names]
    return known._replace(
        channels=known.channels.union(*others), may_isolate=known.may_isolate.union(*others)
    )


def _own_visibility(label: Label) -> FaultVisibility:
    """Which channels of the built-in detectors can see the fault of a label."""
    if label.fault == "gps-spoof":
        return RECEIVER_VISIBILITY
    if label.fault in HARMLESS_FAULTS:
        return FaultVisibility(frozenset(), reason=HARMLESS_FAULTS[label.fault])
    if label.where.get("system") in GROUND_STATIONS:
        return FaultVisibility(frozenset(), reason="no channel monitors a ground station's frames")
    if not label.targets:
        return _link_visibility(label)
    parts = [
        _lost_satellite(target)
        if label.fault in LOSS_FAULTS and _is_satellite(target)
        else target_visibility(target, label.parameters)
        for target in label.targets
    ]
    # An unmonitored target does not hide the monitored ones.
    observable = [one for one in parts if one.channels]
    if not observable:
        return parts[0]
    merged = FaultVisibility(
        frozenset().union(*(one.channels for one in observable)),
        tuple(dict.fromkeys(names for one in observable for names in one.must_isolate)),
        frozenset().union(*(one.may_isolate for one in observable)),
    )
    if label.fault in LOSS_FAULTS:  # lost frames are also missing in the link's count
        merged = merged._replace(
            channels=merged.channels | {LINK}, may_isolate=merged.may_isolate | {LINK}
        )
    return merged


def _link_visibility(label: Label) -> FaultVisibility:
    """A fault of the entire link falsifies nothing, but any stream may fall silent."""
    if label.by and not label.fault.startswith(LINK_UNITS):
        return FaultVisibility(frozenset(), reason=f"no channel monitors {label.fault}")
    streams = frozenset({*SENSOR_VISIBILITY, POSITION, SATELLITES})
    if not label.by and label.fault not in LOSS_FAULTS:
        names = streams if label.fault in LATE_FAULTS else frozenset[str]()
        reason = f"{label.fault} on a link changes no value"
        return FaultVisibility(frozenset(), may_isolate=names, reason=reason)
    any_name = streams | ENTIRE_RECEIVER
    return FaultVisibility(frozenset({LINK}), (any_name,), any_name)


def target_visibility(
    target: str, parameters: Mapping[str, object] = NO_PARAMETERS
) -> FaultVisibility:
    """The visibility of a falsified target; `parameters` are those of the fault."""
    message, _, path = target.partition(".")
    name = path.partition("[")[0]
    if message in ("PSEUDORANGE", "TUNNEL"):
        return _satellite_visibility(path)
    if message == "PLANT":
        satellite = SATELLITE.search(path)
        if satellite is not None:
            lost = path.startswith("satellite_lost")
            return (_lost_satellite if lost else _satellite_visibility)(satellite.group())
        if RECEIVER_PLANT_FAULT.fullmatch(path):
            return RECEIVER_VISIBILITY
        if name in SENSOR_PLANT_FAULTS:
            return _any_of(*(SENSOR_VISIBILITY[one] for one in SENSOR_PLANT_FAULTS[name]))
        motor, surface = MOTOR.fullmatch(path), SURFACE.fullmatch(path)
        if motor is not None:
            number = int(motor[2])
            # A fixed wing's only motor is its throttle.
            return _actuator({f"motor {number + 1}", *(["throttle"] if number == 0 else [])})
        if surface is not None:
            return _actuator({surface[1]})
        return FaultVisibility(frozenset(), reason=f"no channel monitors the plant ({path})")
    if message in FIX_MESSAGES:
        return FIX_VISIBILITY
    if message == "HIL_ACTUATOR_CONTROLS":
        return _output_visibility(path)
    devices = _devices(message, name, parameters)
    if not devices:
        return FaultVisibility(frozenset(), reason=f"no channel monitors {target}")
    return _any_of(*(SENSOR_VISIBILITY[device] for device in devices))


def _actuator(names: set[str]) -> FaultVisibility:
    """Actuators, one of which must be isolated."""
    return FaultVisibility(frozenset({ACTUATORS}), (frozenset(names),), frozenset(names))


def _output_visibility(path: str) -> FaultVisibility:
    """The actuators of one output, or of any where the target is the entire message."""
    index = re.fullmatch(r"controls\[(\d+)\]", path)
    outputs = range(OUTPUTS) if index is None else (int(index[1]),)
    motors = {f"motor {output + 1}" for output in outputs}
    return _actuator(
        motors | {PLANE_OUTPUTS[output] for output in outputs if output in PLANE_OUTPUTS}
    )


def _satellite_visibility(name: str) -> FaultVisibility:
    """One satellite; the position of a receiver that uses it is affected too."""
    # `all`, or no satellite: the entire receiver.
    if not SATELLITE.fullmatch(name):
        return RECEIVER_VISIBILITY
    own = frozenset({name})
    return FaultVisibility(RECEIVER_CHANNELS, (own,), own | RECEIVER_NAMES)


def _is_satellite(target: str) -> bool:
    """Whether a target is the range of one satellite."""
    message, _, name = target.partition(".")
    return message == "PSEUDORANGE" and SATELLITE.fullmatch(name) is not None


def _lost_satellite(target: str) -> FaultVisibility:
    """One lost satellite. Isolating it, or the receiver that needs it, is not wrong."""
    names = RECEIVER_NAMES | {target.rpartition(".")[2], SATELLITES, LINK}
    return FaultVisibility(
        frozenset(), (), names, "a lost satellite is no error: terrain hides satellites too"
    )


def _devices(message: str, name: str, parameters: Mapping[str, object]) -> tuple[str, ...]:
    """The sensors of a message's field; without a field all sensors of the message."""
    every = SENSOR_MESSAGES.get(message, ())
    if name == "fields_updated":
        groups = parameters.get("groups")
        named = (
            [SENSOR_GROUPS[g] for g in groups if g in SENSOR_GROUPS]
            if isinstance(groups, list)
            else []
        )
        return tuple(dict.fromkeys(named)) or every
    # Time stamps belong to every sensor of the message.
    if not name or name.startswith("time") or len(every) == 1:
        return every
    return tuple(
        one for one in every if one in SENSOR_FIELDS and SENSOR_FIELDS[one].fullmatch(name)
    )
