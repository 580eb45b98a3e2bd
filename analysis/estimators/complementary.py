"""Complementary filters: gyro for the high frequencies, gravity and magnetic field for the low.

`Mahony` is the explicit complementary filter with bias on the rotation group [1]_; with its
integral gain at zero it is the plain complementary filter, whose crossover lies at the tilt gain in
rad/s. The centripetal acceleration, airspeed times rate, is removed from the specific force, as
that work proposes for fixed wings; the field corrects the heading only, so that a magnetic fault
cannot disturb roll and pitch.

References
----------
.. [1] Mahony, Hamel and Pflimlin, IEEE Trans. Automatic Control 53(5), 2008, equation 48.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from analysis.estimators.estimator import (
    MAX_GAP_S,
    KernelEstimator,
    KernelState,
    Prior,
    airspeed_mps,
    empty_estimates,
)
from analysis.samples.block import (
    AIRSPEED,
    FORCE,
    IMU,
    IMU_ID,
    MAG,
    RATES,
    Indices,
    Stamps,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    gravity_error,
    heading_error,
    rotate_attitude,
    rotation_matrix,
)

BIAS, SIZE = 4, 7  # start of the bias in x; length of x
STATE, FIELD = 0, 1  # stamps: of the state, of the newest field sample


class Gains(NamedTuple):
    """Gains of tilt and heading in 1/s, of the bias in 1/s^2."""

    tilt: float = 0.5
    heading: float = 0.5
    bias: float = 0.02


@compiled
def predict(
    x: Vector, gyro: Vector, accel: Vector, speed_mps: float, dt_s: float, gains: Gains
) -> Vector:
    """Propagate x (7,) over one IMU sample and correct it toward the measured gravity."""
    rate = gyro - x[BIAS:]
    error = gravity_error(x[:BIAS], accel, rate, speed_mps, STANDARD_GRAVITY_MPS2)
    step = (rate + gains.tilt * error) * dt_s
    out = np.empty(SIZE)
    out[:BIAS] = rotate_attitude(x[:BIAS], step[0], step[1], step[2])
    out[BIAS:] = x[BIAS:] - gains.bias * dt_s * error
    return out


@compiled
def correct_heading(
    x: Vector, field: Vector, declination_rad: float, dt_s: float, gains: Gains
) -> Vector:
    """Correct the heading in x (7,) by one magnetic field sample (3,) and the declination."""
    error = heading_error(x[:BIAS], field, declination_rad)
    down = rotation_matrix(x[:BIAS])[2]
    # After a gap the step may reach the field's heading but not overshoot it.
    step = min(1.0, gains.heading * dt_s) * error * down
    out = np.empty(SIZE)
    out[:BIAS] = rotate_attitude(x[:BIAS], step[0], step[1], step[2])
    out[BIAS:] = x[BIAS:] - gains.bias * dt_s * error * down
    return out


@compiled
def filter_block(
    kind: Indices, t_us: Stamps, values: Vector, state: KernelState, gains: Gains
) -> tuple[Stamps, Vector, KernelState]:
    """Run the filter over a block (see `analysis.samples.block`); x (7,) is q_nb and gyro bias.

    Returns stamps (m,) and q_nb (m, 4) after each IMU sample, then the state.
    """
    when, q_nb = empty_estimates(kind)
    x, stamps, speed_mps, declination_rad = state
    stamps = stamps.copy()
    done = 0
    for i in range(len(kind)):
        if kind[i] == IMU:
            dt_s = (t_us[i] - stamps[STATE]) * 1e-6
            # A longer gap is not integrated; field and gravity correct the estimate afterwards.
            if 0.0 < dt_s <= MAX_GAP_S:
                gyro, accel = values[i, RATES:FORCE], values[i, FORCE:IMU_ID]
                x = predict(x, gyro, accel, speed_mps, dt_s, gains)
            # A late sample must not set the clock back.
            stamps[STATE] = max(t_us[i], stamps[STATE])
            when[done] = stamps[STATE]
            for k in range(BIAS):
                q_nb[done, k] = x[k]
            done += 1
        # A repeated stamp is the same sample again: it must not count twice.
        elif kind[i] == MAG and t_us[i] > stamps[FIELD]:
            # Bounded: after a long gap one field sample must not turn the attitude at once.
            dt_s = min((t_us[i] - stamps[FIELD]) * 1e-6, MAX_GAP_S)
            x = correct_heading(x, values[i, 0:3], declination_rad, dt_s, gains)
            stamps[FIELD] = t_us[i]
        elif kind[i] == AIRSPEED:
            speed_mps = airspeed_mps(values[i, 0])
    return when, q_nb, KernelState(x, stamps, speed_mps, declination_rad)


@dataclass(frozen=True)
class Mahony(KernelEstimator):
    """The explicit complementary filter with its gains."""

    tuning: Gains = field(default=Gains())
    filter_block = staticmethod(filter_block)

    def start(self, prior: Prior) -> KernelState:
        """The prior's attitude, no bias."""
        x = np.concatenate([prior.q_nb, np.zeros(3)])
        return KernelState(x, np.array([prior.t_us] * 2), 0.0, prior.declination_rad)


def complementary() -> Mahony:
    """The plain complementary filter: no bias, crossover at 0.5 rad/s."""
    # Without its integral term Mahony's filter is the plain one.
    return Mahony(Gains(bias=0.0))
