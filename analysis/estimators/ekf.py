"""A quaternion EKF: attitude, gyro bias and velocity; nine error states.

The error is a small turn in body axes beside the errors of bias and velocity [1]_. The IMU drives
the prediction; velocity over ground from GPS, compared with the integrated specific force, shows
the tilt in turning flight too, where gravity alone would not. The field shows the heading. Without
GPS velocity for `gps_timeout_s`, gravity freed of the centripetal part takes over.

References
----------
.. [1] Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 5.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.epochs import AirspeedSample, GpsFix, ImuSample, MagSample, Sample
from analysis.estimators import ekf_kernel
from analysis.estimators.base import MAX_GAP_S, AttitudeEstimate, Prior, airspeed_mps

Vector = NDArray[np.float64]
MIN_FIX = 3  # GPS_FIX_TYPE_3D_FIX


class EkfState(NamedTuple):
    """x (91,): q_nb, bias in rad/s, velocity NED in m/s, covariance (9, 9) of the errors by rows.

    `tilt_t_us` is when gravity was last used.
    """

    t_us: int
    x: Vector
    airspeed_mps: float
    declination_rad: float
    gps_t_us: int
    tilt_t_us: int


@dataclass(frozen=True, slots=True)
class Ekf:
    """Noise densities per root hertz, and one-sigma values of the measurements.

    The defaults suit a small vehicle's MEMS sensors with their vibration.
    """

    gyro_density: float = 2e-3  # rad/s/sqrt(Hz)
    bias_density: float = 2e-4  # rad/s^2/sqrt(Hz)
    accel_density: float = 0.05  # m/s^2/sqrt(Hz)
    velocity_sigma_mps: float = 0.2
    heading_sigma_rad: float = 0.05
    gravity_sigma_mps2: float = 1.0
    gravity_period_s: float = 0.1
    gps_timeout_s: float = 2.0
    start_sigma: tuple[float, float, float] = (0.05, 0.05, 0.5)  # rad, rad/s, m/s

    def start(self, prior: Prior) -> EkfState:
        """The prior with `start_sigma`; GPS is taken as missing until its first fix."""
        sigma = np.repeat(self.start_sigma, 3)
        x = np.concatenate([prior.q_nb, np.zeros(3), prior.v_ned_mps, np.diag(sigma**2).ravel()])
        timeout_us = round(self.gps_timeout_s * 1e6)
        return EkfState(
            prior.t_us, x, 0.0, prior.declination_rad, prior.t_us - timeout_us, prior.t_us
        )

    def update(self, reading: Sample, state: EkfState) -> tuple[AttitudeEstimate, EkfState]:
        """IMU predicts; velocity, field and (where GPS is missing) gravity correct."""
        if isinstance(reading, ImuSample):
            state = self._predicted(reading, state)
        elif isinstance(reading, MagSample):
            x = ekf_kernel.head(
                state.x, reading.field_b_gauss, state.declination_rad, self.heading_sigma_rad**2
            )
            state = state._replace(x=x)
        elif isinstance(reading, GpsFix):
            state = self._with_velocity(reading, state)
        elif isinstance(reading, AirspeedSample):
            state = state._replace(airspeed_mps=airspeed_mps(reading.diff_pressure_pa))
        return AttitudeEstimate(state.t_us, state.x[:4]), state

    def _predicted(self, reading: ImuSample, state: EkfState) -> EkfState:
        t_us = reading.t_us
        dt_s = (t_us - state.t_us) * 1e-6
        if dt_s <= 0.0:
            return state
        x, tilt_t_us = state.x, state.tilt_t_us
        if dt_s <= MAX_GAP_S:
            x = ekf_kernel.predict(
                x,
                reading.gyro_b_rps,
                reading.accel_b_mps2,
                dt_s,
                self.gyro_density,
                self.bias_density,
                self.accel_density,
            )
        blind = t_us - state.gps_t_us >= self.gps_timeout_s * 1e6
        if blind and t_us - tilt_t_us >= self.gravity_period_s * 1e6:
            x = ekf_kernel.level(
                x,
                reading.gyro_b_rps,
                reading.accel_b_mps2,
                state.airspeed_mps,
                self.gravity_sigma_mps2**2,
            )
            tilt_t_us = t_us
        return EkfState(
            t_us, x, state.airspeed_mps, state.declination_rad, state.gps_t_us, tilt_t_us
        )

    def _with_velocity(self, fix: GpsFix, state: EkfState) -> EkfState:
        if fix.v_ned_mps is None or fix.fix_type < MIN_FIX or not np.isfinite(fix.v_ned_mps).all():
            return state  # GPS_RAW_INT does not tell the climb
        variance = self.velocity_sigma_mps**2
        if fix.t_us - state.gps_t_us >= self.gps_timeout_s * 1e6:
            x = ekf_kernel.restart_velocity(state.x, fix.v_ned_mps, variance)
        else:
            x = ekf_kernel.correct_velocity(state.x, fix.v_ned_mps, variance)
        return state._replace(x=x, gps_t_us=max(fix.t_us, state.gps_t_us))
