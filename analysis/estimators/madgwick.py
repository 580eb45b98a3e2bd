"""Madgwick's gradient filter, from the `ahrs` package.

`ahrs` expects gravity to read positive on the third axis; the specific force in forward-right-down
axes is negative there at rest, so its sign is reversed. The filter's north is magnetic: the
returned attitude is rotated by the declination.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np

from analysis.estimators.estimator import MAX_GAP_S, AttitudeEstimate, Prior
from analysis.samples.sample import ImuSample, MagSample, Sample, Vector
from mavproxy_fault.documents.extras import import_extra, require_extra


class MadgwickState(NamedTuple):
    """Attitude relative to magnetic north; the field sample since the last IMU sample, or None."""

    t_us: int
    q_mb: Vector
    field: Vector | None
    declination_rad: float


@dataclass(frozen=True)
class Madgwick:
    """`gain` is beta in rad/s; 0.041 is the paper's value for an IMU with a magnetometer."""

    gain: float = 0.041

    def __post_init__(self) -> None:
        require_extra("ahrs")

    @cached_property
    def _filter(self) -> Any:
        return import_extra("ahrs.filters").Madgwick(gain=self.gain)

    def start(self, prior: Prior) -> MadgwickState:
        """The prior's attitude, relative to magnetic north."""
        q = _rotate_yaw(prior.q_nb, -prior.declination_rad)
        return MadgwickState(prior.t_us, q, None, prior.declination_rad)

    def update(
        self, reading: Sample, state: MadgwickState
    ) -> tuple[AttitudeEstimate, MadgwickState]:
        """Keep a field sample for the next IMU sample, which advances the filter."""
        if isinstance(reading, MagSample):
            state = state._replace(field=reading.field_b_gauss)
        elif isinstance(reading, ImuSample) and reading.t_us > state.t_us:
            state = self._advance(reading, state)
        return AttitudeEstimate(state.t_us, _rotate_yaw(state.q_mb, state.declination_rad)), state

    def _advance(self, reading: ImuSample, state: MadgwickState) -> MadgwickState:
        dt_s = (reading.t_us - state.t_us) * 1e-6
        if dt_s > MAX_GAP_S:
            return state._replace(t_us=reading.t_us)
        gyro, accel = reading.gyro_b_rps, -reading.accel_b_mps2
        if state.field is None:
            q = self._filter.updateIMU(state.q_mb, gyro, accel, dt=dt_s)
        else:
            q = self._filter.updateMARG(state.q_mb, gyro, accel, state.field, dt=dt_s)
        # A field sample is used once: a second use would count it twice.
        return MadgwickState(reading.t_us, q, None, state.declination_rad)


def _rotate_yaw(q: Vector, angle_rad: float) -> Vector:
    """q (4,) rotated by an angle about down."""
    c, s = cos(0.5 * angle_rad), sin(0.5 * angle_rad)
    w, x, y, z = q
    return np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
