"""Conversion of one HIL step into the inputs of ArduPilot's drivers: VectorNav and JSON physics.

HIL_SENSOR id 0 and HIL_GPS id 0 become the VectorNav, HIL_SENSOR id 1 the IMU of the JSON backend.
For a sample dropped by a fault no packet is sent; the JSON backend cannot omit one and repeats its
last.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mavproxy_fault.ardupilot.feeding.json_physics import BodyState, state_line
from mavproxy_fault.ardupilot.feeding.vectornav import (
    NO_FIX,
    BinaryOutput,
    GnssOutput,
    ImuOutput,
    Pace,
    gnss_values,
    imu_values,
)
from mavproxy_fault.ardupilot.hil_readings import (
    DIFF_PRESSURE,
    ID_GPS,
    HilImu,
    Readings,
    TrueState,
    true_airspeed,
)
from mavproxy_fault.wire.frame import Frame

GPS_EPOCH_US = 2348 * 604_800_000_000  # 5 January 2025, as HIL_GPS has no date
ESTIMATE_PERIOD_US = 20_000  # chosen: 50 Hz is enough for a health check
SPEED_SIGMA_MPS = 0.3  # not in HIL_GPS; typical of a consumer receiver
M_PER_E7_DEG = 0.011131884502145034  # ArduPilot's scale of --home, Location.h
DOP_PER_M = 1 / 2.5  # DOP of a receiver with a range error of 2.5 m
WORST_DOP = 99.0


class StepBytes(NamedTuple):
    """Bytes for ArduPilot's drivers in one step."""

    vectornav: bytes
    physics: bytes


class SensorFeed:
    """The sensors of one flight.

    Parameters
    ----------
    home : TrueState
        State at ArduPilot's `--home`.
    """

    def __init__(self, home: TrueState) -> None:
        self._home = home
        self._values = gnss_values(NO_FIX)
        self._estimate_us = 0

    def step(
        self, readings: Readings, truth: TrueState, outputs: Sequence[BinaryOutput] = ()
    ) -> StepBytes:
        """Encode a step that the truth has ended, for the VectorNav's configured `outputs`."""
        first = readings.imus[0]
        self._values |= imu_values(
            ImuOutput(
                truth.t_us,
                first.gyro_b_rps,
                first.accel_b_mps2,
                first.field_b_gauss,
                first.temperature_c,
                first.pressure_pa,
            ),
            GPS_EPOCH_US,
        )
        packets = self._packets("imu", outputs) if readings.fresh_imu else []
        for frame in readings.fixes:
            if frame.number("id") == ID_GPS:
                self._values |= gnss_values(gnss_output(frame))
                packets += self._packets("gnss", outputs)
        if truth.t_us - self._estimate_us >= ESTIMATE_PERIOD_US:
            self._estimate_us = truth.t_us
            packets += self._packets("estimate", outputs)
        second = readings.imus.get(1, first)
        airspeed = true_airspeed(first) if readings.updated & DIFF_PRESSURE else None
        line = self._body_state(truth, second)._replace(airspeed_mps=airspeed)
        return StepBytes(b"".join(packets), state_line(line))

    def _packets(self, pace: Pace, outputs: Sequence[BinaryOutput]) -> list[bytes]:
        return [output.packet(self._values) for output in outputs if output.pace == pace]

    def _body_state(self, truth: TrueState, imu: HilImu) -> BodyState:
        home = self._home
        north_m = (truth.lat_e7 - home.lat_e7) * M_PER_E7_DEG
        east_m = (truth.lon_e7 - home.lon_e7) * M_PER_E7_DEG * longitude_scale(home.lat_e7)
        down_m = (home.alt_mm - truth.alt_mm) * 1e-3
        return BodyState(
            truth.t_us,
            imu.gyro_b_rps,
            imu.accel_b_mps2,
            (north_m, east_m, down_m),
            truth.q_nb,
            truth.v_ned_mps,
        )


def longitude_scale(lat_e7: int) -> float:
    """Return the length ratio of a degree of longitude to one of latitude, on a sphere."""
    return max(math.cos(math.radians(lat_e7 * 1e-7)), 0.01)


def gnss_output(frame: Frame) -> GnssOutput:
    """Convert a HIL_GPS to VectorNav values; its eph and epv are errors in centimetres."""
    read = frame.number
    horizontal_m, vertical_m = read("eph") * 0.01, read("epv") * 0.01
    return GnssOutput(
        int(read("satellites_visible")),
        int(read("fix_type")),
        read("lat") * 1e-7,
        read("lon") * 1e-7,
        read("alt") * 1e-3,
        (read("vn") * 0.01, read("ve") * 0.01, read("vd") * 0.01),
        (horizontal_m, horizontal_m, vertical_m),
        SPEED_SIGMA_MPS,
        min(horizontal_m * DOP_PER_M, WORST_DOP),
    )
