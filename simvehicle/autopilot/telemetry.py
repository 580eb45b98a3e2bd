"""The vehicle's telemetry: one function per message, each from a snapshot of one instant.

The list of flight modes follows the "Standard Modes Protocol" of the MAVLink developer guide.
"""

import math
from dataclasses import dataclass

from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from simvehicle.autopilot.enums import (
    AUTOPILOT_PX4,
    BaseMode,
    Capability,
    FlightMode,
    LandedState,
    StandardMode,
    SysStatusSensor,
    SystemState,
)
from simvehicle.hil import hil_messages
from simvehicle.hil.hil_messages import Message, make_message
from simvehicle.sensors.readings import BatteryReading, GpsReading
from simvehicle.vehicles.body import Truth

NO_GPS_FIX = 1  # GPS_FIX_TYPE_NO_FIX
# major, minor, patch, FIRMWARE_VERSION_TYPE_OFFICIAL: the emulated PX4 release
FIRMWARE_VERSION = 1 << 24 | 18 << 16 | 0 << 8 | 255
PRESENT_SENSORS = sum(SysStatusSensor)


# Name and standard mode of each, in the order of the list
LISTED_MODES = {
    FlightMode.TAKEOFF: (b"Takeoff", StandardMode.TAKEOFF),
    FlightMode.HOLD: (b"Hold", StandardMode.NON_STANDARD),
    FlightMode.MISSION: (b"Mission", StandardMode.MISSION),
    FlightMode.RETURN: (b"Return", StandardMode.SAFE_RECOVERY),
    FlightMode.LAND: (b"Land", StandardMode.LAND),
}


@dataclass(frozen=True, slots=True)
class HomePosition:
    """Where the vehicle started."""

    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The state that telemetry reports; `stamp_us` is the vehicle's clock."""

    stamp_us: int
    truth: Truth
    gps: GpsReading | None
    battery: BatteryReading
    consumed_mah: float
    home: HomePosition
    mode: FlightMode
    armed: bool
    landed: LandedState
    mav_type: int
    throttle: float
    mission_count: int
    mission_seq: int

    @property
    def boot_ms(self) -> int:
        """Milliseconds on the vehicle's clock."""
        return self.stamp_us // 1000 & 0xFFFFFFFF

    @property
    def euler_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw."""
        return euler_angles(self.truth.q_nb.tolist())


def heartbeat(snapshot: Snapshot) -> Message:
    """Mode and arming state, encoded as PX4 does."""
    base = BaseMode.CUSTOM | BaseMode.AUTO | BaseMode.GUIDED | BaseMode.STABILIZED
    return make_message(
        "HEARTBEAT",
        type=snapshot.mav_type,
        autopilot=AUTOPILOT_PX4,
        base_mode=base | (BaseMode.ARMED if snapshot.armed else 0),
        custom_mode=snapshot.mode,
        system_status=SystemState.ACTIVE if snapshot.armed else SystemState.STANDBY,
        mavlink_version=3,
    )


def sys_status(snapshot: Snapshot) -> Message:
    """Battery, and all sensors healthy: the proxy injects faults and reports them itself."""
    battery = snapshot.battery
    return make_message(
        "SYS_STATUS",
        onboard_control_sensors_present=PRESENT_SENSORS,
        onboard_control_sensors_enabled=PRESENT_SENSORS,
        onboard_control_sensors_health=PRESENT_SENSORS,
        voltage_battery=round(battery.voltage_v * 1e3),
        current_battery=round(battery.current_a * 100),
        battery_remaining=round(battery.remaining * 100),
    )


def attitude(snapshot: Snapshot) -> Message:
    """Euler angles and body rates."""
    roll, pitch, yaw = snapshot.euler_rad
    p, q, r = snapshot.truth.omega_b_rps.tolist()
    return make_message(
        "ATTITUDE",
        time_boot_ms=snapshot.boot_ms,
        roll=roll, pitch=pitch, yaw=yaw, rollspeed=p, pitchspeed=q, yawspeed=r,
    )  # fmt: skip


def attitude_quaternion(snapshot: Snapshot) -> Message:
    """Attitude as a quaternion, and body rates."""
    w, x, y, z = snapshot.truth.q_nb.tolist()
    p, q, r = snapshot.truth.omega_b_rps.tolist()
    return make_message(
        "ATTITUDE_QUATERNION",
        time_boot_ms=snapshot.boot_ms,
        q1=w, q2=x, q3=y, q4=z, rollspeed=p, pitchspeed=q, yawspeed=r,
    )  # fmt: skip


def global_position_int(snapshot: Snapshot) -> Message:
    """Position and velocity over ground."""
    truth = snapshot.truth
    north, east, down = truth.v_ned_mps.tolist()
    return make_message(
        "GLOBAL_POSITION_INT",
        time_boot_ms=snapshot.boot_ms,
        lat=round(math.degrees(truth.lat_rad) * 1e7),
        lon=round(math.degrees(truth.lon_rad) * 1e7),
        alt=round(truth.alt_msl_m * 1e3),
        relative_alt=round((truth.alt_msl_m - snapshot.home.alt_m) * 1e3),
        vx=hil_messages.round_within(north * 100, -0x8000, 0x7FFF),
        vy=hil_messages.round_within(east * 100, -0x8000, 0x7FFF),
        vz=hil_messages.round_within(down * 100, -0x8000, 0x7FFF),
        hdg=_heading_cdeg(snapshot),
    )


def local_position_ned(snapshot: Snapshot) -> Message:
    """Position and velocity relative to home."""
    x, y, z = snapshot.truth.r_ned_m.tolist()
    vx, vy, vz = snapshot.truth.v_ned_mps.tolist()
    return make_message(
        "LOCAL_POSITION_NED",
        time_boot_ms=snapshot.boot_ms,
        x=x, y=y, z=z, vx=vx, vy=vy, vz=vz,
    )  # fmt: skip


def gps_raw_int(snapshot: Snapshot) -> Message:
    """The receiver's last solution; no fix before the first."""
    if snapshot.gps is None:
        return make_message(
            "GPS_RAW_INT",
            time_usec=snapshot.stamp_us,
            fix_type=NO_GPS_FIX,
            eph=0xFFFF, epv=0xFFFF, vel=0xFFFF, cog=0xFFFF, satellites_visible=0,
        )  # fmt: skip
    values = hil_messages.hil_gps(snapshot.gps, snapshot.stamp_us)[1]
    shared = ("time_usec", "fix_type", "lat", "lon", "alt", "vel", "cog", "satellites_visible")
    return make_message(
        "GPS_RAW_INT",
        **{name: values[name] for name in shared},
        eph=0xFFFF,  # dilution of precision: unknown
        epv=0xFFFF,
        h_acc=hil_messages.round_within(snapshot.gps.eph_m * 1e3, 0, 0xFFFFFFFF),
        v_acc=hil_messages.round_within(snapshot.gps.epv_m * 1e3, 0, 0xFFFFFFFF),
    )


def vfr_hud(snapshot: Snapshot) -> Message:
    """Head-up display values; the airspeed is indicated airspeed."""
    truth = snapshot.truth
    north, east, down = truth.v_ned_mps.tolist()
    airspeed = math.hypot(*truth.v_air_b_mps.tolist())
    return make_message(
        "VFR_HUD",
        airspeed=airspeed * math.sqrt(truth.density_kgpm3 / SEA_LEVEL_DENSITY_KGPM3),
        groundspeed=math.hypot(north, east),
        heading=_heading_cdeg(snapshot) // 100,
        throttle=round(snapshot.throttle * 100),
        alt=truth.alt_msl_m,
        climb=-down,
    )


def altitude(snapshot: Snapshot) -> Message:
    """The height above each of its references."""
    truth = snapshot.truth
    above_home = truth.alt_msl_m - snapshot.home.alt_m
    return make_message(
        "ALTITUDE",
        time_usec=snapshot.stamp_us,
        altitude_monotonic=truth.alt_msl_m,
        altitude_amsl=truth.alt_msl_m,
        altitude_local=above_home,
        altitude_relative=above_home,
        altitude_terrain=truth.height_agl_m,
        bottom_clearance=truth.height_agl_m,
    )


def home_position(snapshot: Snapshot) -> Message:
    """The home position, with level attitude facing north."""
    home = snapshot.home
    return make_message(
        "HOME_POSITION",
        latitude=round(home.lat_deg * 1e7),
        longitude=round(home.lon_deg * 1e7),
        altitude=round(home.alt_m * 1e3),
        q=(1.0, 0.0, 0.0, 0.0),
        time_usec=snapshot.stamp_us,
    )


def extended_sys_state(snapshot: Snapshot) -> Message:
    """On the ground or in the air."""
    return make_message("EXTENDED_SYS_STATE", landed_state=snapshot.landed)


def battery_status(snapshot: Snapshot) -> Message:
    """The battery pack as one cell."""
    return hil_messages.battery_status(snapshot.battery, snapshot.consumed_mah)


def system_time(snapshot: Snapshot) -> Message:
    """Time since boot; the simulated vehicle has no calendar time."""
    return make_message("SYSTEM_TIME", time_boot_ms=snapshot.boot_ms)


def mission_current(snapshot: Snapshot) -> Message:
    """The current mission item."""
    return make_message("MISSION_CURRENT", seq=snapshot.mission_seq, total=snapshot.mission_count)


def autopilot_version(snapshot: Snapshot) -> Message:
    """The capabilities that the services implement."""
    return make_message(
        "AUTOPILOT_VERSION",
        capabilities=sum(Capability),
        flight_sw_version=FIRMWARE_VERSION,
        uid=1,
    )


def current_mode(snapshot: Snapshot) -> Message:
    """The current mode, as standard mode and as PX4 custom mode."""
    return make_message(
        "CURRENT_MODE",
        standard_mode=LISTED_MODES[snapshot.mode][1],
        custom_mode=snapshot.mode,
        intended_custom_mode=snapshot.mode,
    )


def available_modes(index: int) -> list[Message]:
    """The AVAILABLE_MODES message of an index from 1, or of all for 0; none beyond the last."""
    messages = [
        make_message(
            "AVAILABLE_MODES",
            number_modes=len(LISTED_MODES),
            mode_index=number,
            standard_mode=standard,
            custom_mode=mode,
            mode_name=name,
        )
        for number, (mode, (name, standard)) in enumerate(LISTED_MODES.items(), 1)
    ]
    return messages if index == 0 else messages[index - 1 : index]


def protocol_version(snapshot: Snapshot) -> Message:
    """Both MAVLink 1 and 2 are accepted, 2 is sent."""
    return make_message("PROTOCOL_VERSION", version=200, min_version=100, max_version=200)


def _heading_cdeg(snapshot: Snapshot) -> int:
    return round(math.degrees(snapshot.euler_rad[2]) * 100) % 36000
