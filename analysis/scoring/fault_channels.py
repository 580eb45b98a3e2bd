"""Which channels of the monitor can see a fault, and whom they may rightly blame for it.

A *channel* is what one test of the monitor watches: the satellites, the receiver's own position and
velocity, the IMU, another sensor, the link. What a fault falsifies follows from its targets, and
where it names none from its kind.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from analysis.detection.detector_registry import other_detectors
from mavproxy_fault.wire.label import Label

SATELLITES, POSITION, VELOCITY = "satellites", "gps-position", "gps-velocity"
IMU, MAG, BARO, AIRSPEED, RANGE, VISION, LINK = (
    *("imu", "mag", "baro", "airspeed", "range", "vision", "link"),
)
ACTUATORS = "actuators"
RECEIVER_NAMES = frozenset(
    {POSITION, VELOCITY, "GPS", "clock"}
)  # names by which a receiver is blamed
RECEIVER_CHANNELS = frozenset({SATELLITES, POSITION, VELOCITY})
EVERY_SATELLITE = "every satellite"
SATELLITE = re.compile(r"[GRECJSI]\d\d")


class FaultVisibility(NamedTuple):
    """Who can see a fault and who is to blame.

    `channels` can see it; of each set in `must_isolate` one name must be blamed, and whoever is in
    `may_isolate` is blamed rightly. Without channels `reason` says why nothing can see it.
    """

    channels: frozenset[str]
    must_isolate: tuple[frozenset[str], ...] = ()
    may_isolate: frozenset[str] = frozenset()
    reason: str = ""

    def allows(self, name: str) -> bool:
        """Whether a name is blamed rightly."""
        # A fault of the whole sky is rightly blamed on any of them.
        if EVERY_SATELLITE in self.may_isolate and SATELLITE.fullmatch(name):
            return True
        return name in self.may_isolate


def _sensor(name: str) -> FaultVisibility:
    own = frozenset({name})
    return FaultVisibility(own, (own,), own)


def _any_of(*sights: FaultVisibility) -> FaultVisibility:
    """One source of all of these: it is enough that one of them is blamed."""
    names = frozenset().union(*(sight.may_isolate for sight in sights))
    return FaultVisibility(
        frozenset().union(*(sight.channels for sight in sights)), (names,), names
    )


# The test of an epoch or a fix holds it against the IMU: its alarm may be the IMU's.
IMU_VISIBILITY = FaultVisibility(
    frozenset({IMU, SATELLITES, POSITION}), (frozenset({IMU}),), frozenset({IMU})
)
FIX_VISIBILITY = FaultVisibility(frozenset({POSITION, VELOCITY}), (RECEIVER_NAMES,), RECEIVER_NAMES)
# As a name "satellites" is the stream of raw ranges, which falls silent as a whole.
ENTIRE_RECEIVER = RECEIVER_NAMES | {SATELLITES, EVERY_SATELLITE}
RECEIVER_VISIBILITY = FaultVisibility(RECEIVER_CHANNELS, (ENTIRE_RECEIVER,), ENTIRE_RECEIVER)
SENSOR_VISIBILITY = {name: _sensor(name) for name in (MAG, BARO, AIRSPEED, RANGE, VISION, LINK)}
SENSOR_VISIBILITY |= {IMU: IMU_VISIBILITY}

# What the outputs of HIL_ACTUATOR_CONTROLS, from 0, drive: a multirotor's motors in their order,
# and on a fixed wing these [1]_. A plane has no motor 5, and a hexarotor no throttle.
OUTPUTS = 16
NO_PARAMETERS: Mapping[str, object] = {}
PLANE_OUTPUTS = {2: "rudder", 4: "throttle", 5: "aileron", 6: "aileron", 7: "elevator"}
MOTOR = re.compile(r"(motor|propeller)_efficiency\[(\d+)\]")
SURFACE = re.compile(r"(elevator|aileron|rudder)_efficiency")

MAG_FIELDS = re.compile(r"[xyz]mag")
IMU_FIELDS = re.compile(r"[xyz](gyro|acc)")
BARO_FIELDS = ("abs_pressure", "press_abs", "pressure_alt")
AIR_FIELDS = ("diff_pressure", "press_diff")
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
# Faults that act on the link's bytes and frames, whatever is in them
LOSS_FAULTS = (
    *("outage", "drop", "burst-loss", "gilbert-elliott", "rate-limit", "corrupt", "truncate"),
    "sequence-gap",
)
HARMLESS_FAULTS = {  # nobody has anything to say of them
    "command": "a command to the vehicle falsifies nothing",
    "duplicate": "what comes twice is as it was",
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
    if not label.targets:
        return _link_visibility(label.fault)
    found = [
        _lost_satellite(target)
        if label.fault in LOSS_FAULTS and _is_satellite(target)
        else target_visibility(target, label.parameters)
        for target in label.targets
    ]
    # A target that nothing watches does not hide the ones that are watched.
    seen = [one for one in found if one.channels]
    if not seen:
        return found[0]
    merged = FaultVisibility(
        frozenset().union(*(one.channels for one in seen)),
        tuple(dict.fromkeys(culprit for one in seen for culprit in one.must_isolate)),
        frozenset().union(*(one.may_isolate for one in seen)),
    )
    if (
        label.fault in LOSS_FAULTS
    ):  # the frames that are lost are missing in the link's count as well
        merged = merged._replace(
            channels=merged.channels | {LINK}, may_isolate=merged.may_isolate | {LINK}
        )
    return merged


def _link_visibility(fault: str) -> FaultVisibility:
    """A fault of the whole link falsifies nobody, but everybody may fall silent."""
    if fault not in LOSS_FAULTS:
        return FaultVisibility(
            frozenset(), reason=f"{fault} on a link leaves every value as it was"
        )
    everybody = frozenset({*SENSOR_VISIBILITY, *ENTIRE_RECEIVER})
    return FaultVisibility(frozenset({LINK}), (everybody,), everybody)


def target_visibility(
    target: str, parameters: Mapping[str, object] = NO_PARAMETERS
) -> FaultVisibility:
    """Who can see that a target is falsified; `parameters` are those of the fault."""
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
        motor, surface = MOTOR.fullmatch(path), SURFACE.fullmatch(path)
        if motor is not None:
            number = int(motor[2])
            # A fixed wing's only motor is its throttle.
            return _actuator({f"motor {number + 1}", *(["throttle"] if number == 0 else [])})
        if surface is not None:
            return _actuator({surface[1]})
        return FaultVisibility(frozenset(), reason=f"no channel watches the plant ({path})")
    if message in FIX_MESSAGES:
        return FIX_VISIBILITY
    if message == "HIL_ACTUATOR_CONTROLS":
        return _output_visibility(path)
    devices = _devices(message, name, parameters)
    if not devices:
        return FaultVisibility(frozenset(), reason=f"no channel watches {target}")
    return _any_of(*(SENSOR_VISIBILITY[device] for device in devices))


def _actuator(names: set[str]) -> FaultVisibility:
    """Actuators of which one is to blame."""
    return FaultVisibility(frozenset({ACTUATORS}), (frozenset(names),), frozenset(names))


def _output_visibility(path: str) -> FaultVisibility:
    """What one output drives, or any of them where the whole message is meant."""
    index = re.fullmatch(r"controls\[(\d+)\]", path)
    outputs = range(OUTPUTS) if index is None else (int(index[1]),)
    motors = {f"motor {output + 1}" for output in outputs}
    return _actuator(
        motors | {PLANE_OUTPUTS[output] for output in outputs if output in PLANE_OUTPUTS}
    )


def _satellite_visibility(name: str) -> FaultVisibility:
    """One satellite; a receiver that uses it drags its own position along."""
    # `all`, or what is no satellite: the receiver as a whole.
    if not SATELLITE.fullmatch(name):
        return RECEIVER_VISIBILITY
    own = frozenset({name})
    return FaultVisibility(RECEIVER_CHANNELS, (own,), own | RECEIVER_NAMES)


def _is_satellite(target: str) -> bool:
    """Whether a target is the ranges of one satellite."""
    message, _, name = target.partition(".")
    return message == "PSEUDORANGE" and SATELLITE.fullmatch(name) is not None


def _lost_satellite(target: str) -> FaultVisibility:
    """One satellite that no longer comes in. Blaming it would not be wrong, nor who needs it."""
    names = RECEIVER_NAMES | {target.rpartition(".")[2], SATELLITES, LINK}
    return FaultVisibility(
        frozenset(), (), names, "a hill hides a satellite as well: it is no error"
    )


def _devices(message: str, name: str, parameters: Mapping[str, object]) -> tuple[str, ...]:
    """The sensors that a field of a message belongs to; without a field all that speak in it."""
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
    for device, fields in ((IMU, IMU_FIELDS), (MAG, MAG_FIELDS)):
        if device in every and fields.fullmatch(name):
            return (device,)
    for device, names in ((BARO, BARO_FIELDS), (AIRSPEED, AIR_FIELDS)):
        if device in every and name in names:
            return (device,)
    return ()
