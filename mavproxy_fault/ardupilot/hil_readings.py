"""Latest sensor readings and truth from the HIL link, in SI units; no I/O.

A simulator ends each step with the truth, HIL_STATE_QUATERNION, so its timestamp closes the step
whatever a fault did to the sensor frames before it.
"""

import math
import struct
from typing import NamedTuple

from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from mavproxy_fault.wire.frame import Frame

INERTIAL, MAG, BARO, DIFF_PRESSURE = 0x3F, 0x1C0, 0x1A00, 0x400  # HIL_SENSOR_UPDATED_*
PA_PER_HPA = 100.0
ZERO_CELSIUS_K = 273.15
AIR_J_PER_KG_K = 287.05287  # gas constant of dry air, ISO 2533
ID_BATTERY = 0
CELLS, NO_CELL, MV_PER_V = 10, 0xFFFF, 1e3  # of BATTERY_STATUS.voltages
ID_GPS = 0  # the receiver that is part of the VectorNav

_SENSOR = struct.Struct("<Q13fIB")
_TRUTH = struct.Struct("<Q4f3f3i3h")
Triple = tuple[float, float, float]


class HilImu(NamedTuple):
    """One HIL_SENSOR."""

    accel_b_mps2: Triple
    gyro_b_rps: Triple
    field_b_gauss: Triple
    pressure_pa: float
    diff_pressure_pa: float
    temperature_c: float


class TrueState(NamedTuple):
    """One HIL_STATE_QUATERNION."""

    t_us: int
    q_nb: tuple[float, float, float, float]
    lat_e7: int
    lon_e7: int
    alt_mm: int
    v_ned_mps: Triple

    @property
    def yaw_deg(self) -> float:
        """Heading from true north, 0 to 360 degrees."""
        _, _, yaw_rad = euler_angles(self.q_nb)
        return math.degrees(yaw_rad) % 360.0


class Readings:
    """The newest values of each sensor, and which are new since the last step.

    Attributes
    ----------
    imus : dict of int to HilImu
        By HIL_SENSOR.id.
    truth : TrueState or None
    battery_v : float or None
        Voltage of the first battery.
    fresh_imu : bool
        A HIL_SENSOR of id 0 with new samples was received since `begin_step`.
    fixes : list of Frame
        HIL_GPS received since `begin_step`.
    updated : int
        All bits of HIL_SENSOR.fields_updated received so far.
    """

    def __init__(self) -> None:
        self.imus: dict[int, HilImu] = {}
        self.truth: TrueState | None = None
        self.battery_v: float | None = None
        self.fresh_imu = False
        self.fixes: list[Frame] = []
        self.updated = 0

    def begin_step(self) -> None:
        """Clear the flags of new data."""
        self.fresh_imu = False
        self.fixes = []

    def update(self, frame: Frame) -> bool:
        """Read a frame; return True if it ends a step."""
        name = frame.layout.name
        if name == "HIL_SENSOR":
            self._sensor(frame)
        elif name == "HIL_GPS":
            self.fixes.append(frame)
        elif name == "BATTERY_STATUS":
            self.battery_v = read_battery(frame) or self.battery_v
        elif name == "HIL_STATE_QUATERNION":
            t_us, w, x, y, z, _, _, _, lat, lon, alt, vx, vy, vz = _TRUTH.unpack_from(
                frame.payload.ljust(_TRUTH.size, b"\0")
            )
            velocity = (vx * 0.01, vy * 0.01, vz * 0.01)
            self.truth = TrueState(t_us, (w, x, y, z), lat, lon, alt, velocity)
            return True
        return False

    def _sensor(self, frame: Frame) -> None:
        # MAVLink 2 truncates trailing zeros of a payload.
        _, *values, updated, number = _SENSOR.unpack(frame.payload.ljust(_SENSOR.size, b"\0"))
        ax, ay, az, p, q, r, mx, my, mz, pressure, diff_pressure, _, temperature_c = values
        self.imus[number] = HilImu(
            (ax, ay, az),
            (p, q, r),
            (mx, my, mz),
            pressure * PA_PER_HPA,
            diff_pressure * PA_PER_HPA,
            temperature_c,
        )
        self.updated |= updated
        self.fresh_imu |= number == 0 and updated & INERTIAL == INERTIAL


def read_battery(frame: Frame) -> float | None:
    """Return the voltage of the first battery in a BATTERY_STATUS; None without one."""
    cells_mv = [frame.number("voltages", cell) for cell in range(CELLS)]
    known_mv = [voltage_mv for voltage_mv in cells_mv if voltage_mv != NO_CELL]
    return sum(known_mv) / MV_PER_V if frame.number("id") == ID_BATTERY and known_mv else None


def true_airspeed(imu: HilImu) -> float:
    """Compute true airspeed in m/s from pitot pressure and ambient air density."""
    density_kgpm3 = imu.pressure_pa / (AIR_J_PER_KG_K * (imu.temperature_c + ZERO_CELSIUS_K))
    if not density_kgpm3 > 0.0:
        return 0.0
    return math.sqrt(max(2.0 * imu.diff_pressure_pa / density_kgpm3, 0.0))
