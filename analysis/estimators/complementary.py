"""The complementary filters: gyro for the fast part, gravity and the magnetic field for the slow.

`Mahony` is the explicit complementary filter with bias on the rotation group [1]_; with its
integral gain at zero it is the plain complementary filter, whose crossover lies at `tilt_gain`
rad/s. Gravity is freed of the centripetal acceleration by airspeed times rate, as that work
proposes for fixed wings; the field corrects heading only, so that a magnetic fault cannot tilt.

References
----------
.. [1] Mahony, Hamel and Pflimlin, IEEE Trans. Automatic Control 53(5), 2008, equation 48.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import (
    GRAVITY_MPS2,
    MAX_GAP_S,
    AttitudeEstimate,
    Prior,
    airspeed_mps,
)
from analysis.estimators.rotations import gravity_error, heading_error, matrix, turned
from analysis.samples import AirspeedSample, ImuSample, MagSample, Sample
from mavproxy_fault.wire.compiled import compiled

Vector = NDArray[np.float64]


class FilterState(NamedTuple):
    """q_nb (4,) and gyro bias (3,) in rad/s in one array; airspeed, declination, stamps."""

    t_us: int
    x: Vector
    airspeed_mps: float
    declination_rad: float
    mag_t_us: int


@compiled
def predict(
    x: Vector,
    gyro: Vector,
    accel: Vector,
    speed_mps: float,
    dt_s: float,
    gain: float,
    bias_gain: float,
) -> Vector:
    """x (7,) after one IMU sample: the rate less its bias, drawn towards measured gravity."""
    rate = gyro - x[4:7]
    error = gravity_error(x[:4], accel, rate, speed_mps, GRAVITY_MPS2)
    step = (rate + gain * error) * dt_s
    out = np.empty(7)
    out[:4] = turned(x[:4], step[0], step[1], step[2])
    out[4:7] = x[4:7] - bias_gain * dt_s * error
    return out


@compiled
def head(
    x: Vector, field: Vector, declination_rad: float, dt_s: float, gain: float, bias_gain: float
) -> Vector:
    """x (7,) after one field sample (3,): turned about down towards the declination."""
    error = heading_error(x[:4], field, declination_rad)
    down = matrix(x[:4])[2]
    step = min(1.0, gain * dt_s) * error * down
    out = np.empty(7)
    out[:4] = turned(x[:4], step[0], step[1], step[2])
    out[4:7] = x[4:7] - bias_gain * dt_s * error * down
    return out


@dataclass(frozen=True, slots=True)
class Mahony:
    """Gains in 1/s (bias gain in 1/s^2)."""

    tilt_gain: float = 0.5
    heading_gain: float = 0.5
    bias_gain: float = 0.02

    def start(self, prior: Prior) -> FilterState:
        """The prior's attitude, no bias."""
        x = np.concatenate([prior.q_nb, np.zeros(3)])
        return FilterState(prior.t_us, x, 0.0, prior.declination_rad, prior.t_us)

    def update(self, reading: Sample, state: FilterState) -> tuple[AttitudeEstimate, FilterState]:
        """IMU moves, field turns, airspeed is kept for the centripetal part."""
        if isinstance(reading, ImuSample):
            state = self._moved(reading, state)
        elif isinstance(reading, MagSample):
            state = self._headed(reading, state)
        elif isinstance(reading, AirspeedSample):
            state = state._replace(airspeed_mps=airspeed_mps(reading.diff_pressure_pa))
        return AttitudeEstimate(state.t_us, state.x[:4]), state

    def _moved(self, reading: ImuSample, state: FilterState) -> FilterState:
        dt_s = (reading.t_us - state.t_us) * 1e-6
        if dt_s <= 0.0:
            return state
        x = state.x
        if dt_s <= MAX_GAP_S:
            x = predict(
                x,
                reading.gyro_b_rps,
                reading.accel_b_mps2,
                state.airspeed_mps,
                dt_s,
                self.tilt_gain,
                self.bias_gain,
            )
        return FilterState(
            reading.t_us, x, state.airspeed_mps, state.declination_rad, state.mag_t_us
        )

    def _headed(self, reading: MagSample, state: FilterState) -> FilterState:
        dt_s = (reading.t_us - state.mag_t_us) * 1e-6
        if dt_s <= 0.0:
            return state
        x = head(
            state.x,
            reading.field_b_gauss,
            state.declination_rad,
            min(dt_s, MAX_GAP_S),
            self.heading_gain,
            self.bias_gain,
        )
        return state._replace(x=x, mag_t_us=reading.t_us)


def complementary() -> Mahony:
    """The plain complementary filter: no bias, crossover at 0.5 rad/s."""
    return Mahony(bias_gain=0.0)
