"""Conversion of one HIL step into the inputs of ArduPilot's drivers: VectorNav and JSON physics.

HIL_SENSOR id 0 and HIL_GPS id 0 become the VectorNav, HIL_SENSOR id 1 the IMU of the JSON backend.
For a sample dropped by a fault no packet is sent; the JSON backend cannot omit one and repeats its
last.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mavproxy_fault.ardupilot.feeding.json_physics import state_line
from mavproxy_fault.ardupilot.feeding.vectornav import (
    NO_FIX,
    BinaryOutput,
    Pace,
    gnss_values,
    imu_values,
)
from mavproxy_fault.ardupilot.hil_readings import (
    DIFF_PRESSURE,
    ID_GPS,
    Readings,
    Triple,
    TrueState,
    true_airspeed,
)

ESTIMATE_PERIOD_US = 20_000  # chosen: 50 Hz is enough for a health check
M_PER_E7_DEG = 0.011131884502145034  # ArduPilot's scale of --home, Location.h


class StepBytes(NamedTuple):
    """Bytes for ArduPilot's drivers in one step."""

    vectornav: bytes
    physics: bytes


class SensorFeed:
    """The sensors of one flight; `home` is the state at ArduPilot's `--home`."""

    def __init__(self, home: TrueState) -> None:
        self._home = home
        self._values = gnss_values(NO_FIX)
        self._estimate_us = 0

    def step(
        self, readings: Readings, truth: TrueState, outputs: Sequence[BinaryOutput] = ()
    ) -> StepBytes:
        """Encode a step that the truth has ended, for the VectorNav's configured `outputs`."""
        first = readings.imus[0]
        self._values |= imu_values(first, truth.t_us)
        packets = self._packets("imu", outputs) if readings.fresh_imu else []
        for frame in readings.fixes:
            if frame.number("id") == ID_GPS:
                self._values |= gnss_values(frame)
                packets += self._packets("gnss", outputs)
        if truth.t_us - self._estimate_us >= ESTIMATE_PERIOD_US:
            self._estimate_us = truth.t_us
            packets += self._packets("estimate", outputs)
        airspeed = true_airspeed(first) if readings.updated & DIFF_PRESSURE else None
        imu = readings.imus.get(1, first)
        line = state_line(truth, imu, position_from(self._home, truth), airspeed)
        return StepBytes(b"".join(packets), line)

    def _packets(self, pace: Pace, outputs: Sequence[BinaryOutput]) -> list[bytes]:
        return [output.packet(self._values) for output in outputs if output.pace == pace]


def position_from(home: TrueState, truth: TrueState) -> Triple:
    """Return the position from home, NED [m], on ArduPilot's sphere."""
    scale = max(math.cos(math.radians(home.lat_e7 * 1e-7)), 0.01)  # of longitude to latitude
    return (
        (truth.lat_e7 - home.lat_e7) * M_PER_E7_DEG,
        (truth.lon_e7 - home.lon_e7) * M_PER_E7_DEG * scale,
        (home.alt_mm - truth.alt_mm) * 1e-3,
    )
