"""Parameters of the detection filter, of the measurements it uses and of its tests."""

import math
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from analysis.detection.filter.range_noise import SigmaModel
from analysis.orbits.broadcast import SYSTEMS, TYPICAL_ALPHA, TYPICAL_BETA
from analysis.samples.sample import Vector
from mavproxy_fault.documents.document_check import NotNegative

Seconds = Annotated[float, Meta(ge=0, le=1e6)]
Probability = Annotated[float, Meta(gt=0, lt=0.5)]
Axes = tuple[float, float, float]
Klobuchar = tuple[float, float, float, float, float, float, float, float]


class ProcessNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Densities of the filter's process noise.

    Those of the IMU are for a small MEMS part, with a margin for vibration and timing.
    """

    gyro_rps: NotNegative = 2e-3  # rad/s/sqrt(Hz)
    accel_mps2: NotNegative = 2e-2  # m/s^2/sqrt(Hz)
    gyro_walk: NotNegative = 2e-5  # rad/s^2/sqrt(Hz)
    accel_walk: NotNegative = 5e-4  # m/s^3/sqrt(Hz)
    clock_m: NotNegative = 0.3  # m/sqrt(s)
    drift_mps: NotNegative = 0.3  # m/s/sqrt(s)
    isb_m: NotNegative = 0.005  # m/sqrt(s)
    motion_mps2: NotNegative = 3.0  # m/s^2/sqrt(Hz), where no IMU measures the motion


class FilterConfig(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """What the filter uses, the noise it assumes, and the false-alarm probabilities of its tests.

    Each is per GNSS epoch: `p_false_alarm` is that of the main test F00, `p_slow` that of the tests
    with memory, `p_other` that of the Doppler rates and of the other sensors.
    `systems` are the first letters of the systems in use: GPS, Galileo, GLONASS (R), BeiDou (C),
    QZSS (J). `antenna_b_m` is the lever arm from IMU to antenna in body axes, `mask_deg` the lowest
    elevation used, `doppler` whether rates are used, `gap_s` the longest IMU gap that is bridged.
    `ionosphere` holds Klobuchar's coefficients until some are received. With `ionosphere_free` the
    ranges in use are the combinations of two frequencies, of the satellites that have both.
    """

    p_false_alarm: Probability = 1e-4
    p_slow: Probability = 1e-4
    p_other: Probability = 1e-5
    systems: str = "GE"
    antenna_b_m: Axes = (0.0, 0.0, 0.0)
    mask_deg: Annotated[float, Meta(ge=0, lt=90)] = 10.0
    doppler: bool = True
    ionosphere_free: bool = False
    gap_s: Seconds = 0.15
    sigma: SigmaModel = SigmaModel()
    noise: ProcessNoise = ProcessNoise()
    ionosphere: Klobuchar = (*TYPICAL_ALPHA, *TYPICAL_BETA)

    def __post_init__(self) -> None:
        """Refuse unknown systems.

        Raises
        ------
        ValueError
            Naming the field, its value and what is allowed.
        """
        if not self.systems or not set(self.systems) <= set(SYSTEMS):
            raise ValueError(
                f"systems = {self.systems!r} names no system or an unknown one; give letters of "
                f"{SYSTEMS}"
            )

    @cached_property
    def mask_rad(self) -> float:
        """The lowest elevation used."""
        return math.radians(self.mask_deg)

    @cached_property
    def antenna(self) -> Vector | None:
        """The antenna's lever arm (3,); None where it is at the IMU."""
        return np.array(self.antenna_b_m) if any(self.antenna_b_m) else None
