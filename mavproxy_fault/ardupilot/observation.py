"""What the HIL link shows before the autopilot starts: its sensors, its rate, where it stands.

PX4 speaks first, and so does the bridge: a simulator waits for a word. It then goes on without an
answer until the autopilot is there.
"""

import select
import time
from dataclasses import dataclass

from mavproxy_fault.ardupilot.hil_readings import BARO, MAG, Readings, TrueState
from mavproxy_fault.ardupilot.parameters import Fitted, Kind
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import build

MAV_TYPES: dict[Kind, int] = {"copter": 2, "plane": 1}
ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
HELLO_S = 0.5
OBSERVE_US = 1_000_000  # of vehicle time, in which every sensor shows itself
SLOWEST_HZ, FASTEST_HZ = 50.0, 1000.0


@dataclass(frozen=True, slots=True)
class Seen:
    """What was observed; `readings` goes on being updated."""

    readings: Readings
    home: TrueState
    fitted: Fitted


def observe(inbox: Inbox, kind: Kind) -> Seen:
    """Wait for the simulator and watch it for a second of its time.

    Raises
    ------
    ConfigError
        If ArduPilot cannot fly on what it sends.
    """
    link, readings = inbox.link, Readings()
    hello = build(
        known("HEARTBEAT"), {"type": MAV_TYPES[kind], "autopilot": ARDUPILOT, "mavlink_version": 3}
    )
    stamps: list[int] = []
    sensors: set[tuple[str, int]] = set()
    hello_s = 0.0
    first: TrueState | None = None
    # In the vehicle's time: of a slow simulator as many steps are wanted.
    while first is None or stamps[-1] - stamps[0] < OBSERVE_US:
        now_s = time.monotonic()
        if now_s >= hello_s and link.peer_count:
            hello_s = now_s + HELLO_S
            link.write(hello)
        select.select([link.fileno()], [], [], HELLO_S)
        for frame in inbox.frames():
            if "id" in frame.layout.fields:
                sensors.add((frame.layout.name, int(frame.number("id"))))
            if readings.update(frame) and readings.truth is not None:
                first = first or readings.truth
                stamps.append(readings.truth.t_us)
    check_sensors(readings, link.name)
    rate_hz = 1e6 * (len(stamps) - 1) / (stamps[-1] - stamps[0])
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise ConfigError(
            f"{link.name}: {rate_hz:g} steps a second are not for ArduPilot; "
            f"{SLOWEST_HZ:g} to {FASTEST_HZ:g} are, 400 for a copter"
        )
    fitted = Fitted(
        rate_hz,
        second_imu=("HIL_SENSOR", 1) in sensors,
        second_gps=("HIL_GPS", 1) in sensors,
        rangefinder=("DISTANCE_SENSOR", 0) in sensors,
    )
    return Seen(readings, first, fitted)


def check_sensors(readings: Readings, where: str) -> None:
    """Refuse a vehicle without what EKF3 needs.

    Raises
    ------
    ConfigError
        With the sensor that is missing.
    """
    for name, bits in (("compass", MAG), ("barometer", BARO)):
        if readings.updated & bits != bits:
            raise ConfigError(
                f"{where}: HIL_SENSOR comes without a {name}; ArduPilot needs IMU, compass, "
                "barometer and GPS"
            )
    if not readings.fixes:
        raise ConfigError(f"{where}: no HIL_GPS comes; ArduPilot needs a GPS of id 0")
