"""A quaternion EKF: attitude, gyro bias and velocity; nine error states.

The error state is a small rotation in body axes and the errors of bias and velocity [1]_. The IMU
drives the prediction; velocity over ground from GPS, compared with the integrated specific force,
observes the tilt in turning flight too, where gravity alone does not. The field observes the
heading. After `gps_timeout_s` without GPS velocity, the specific force less its centripetal part
serves as gravity.

References
----------
.. [1] Sola, Quaternion kinematics for the error-state Kalman filter, 2017, section 5.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from analysis.estimators import ekf_kernel
from analysis.estimators.estimator import AttitudeEstimate, Prior
from analysis.samples.block import Block, Stamps, block_of
from analysis.samples.sample import Sample, Vector


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
    """The noise that it assumes, and one sigma of its first attitude, bias and velocity."""

    tuning: ekf_kernel.Tuning = field(default=ekf_kernel.Tuning())
    start_sigma: tuple[float, float, float] = (0.05, 0.05, 0.5)  # rad, rad/s, m/s

    def start(self, prior: Prior) -> EkfState:
        """The prior with `start_sigma`; GPS counts as missing until its first fix."""
        # The same for the three axes of each error.
        sigma = np.repeat(self.start_sigma, 3)
        # The bias is unknown at start, so that it begins at zero with its sigma.
        x = np.concatenate([prior.q_nb, np.zeros(3), prior.v_ned_mps, np.diag(sigma**2).ravel()])
        timeout_us = round(self.tuning.gps_timeout_s * 1e6)
        # The last velocity counts as timed out: gravity is used until the first GPS fix.
        return EkfState(
            prior.t_us, x, 0.0, prior.declination_rad, prior.t_us - timeout_us, prior.t_us
        )

    def update(self, reading: Sample, state: EkfState) -> tuple[AttitudeEstimate, EkfState]:
        """IMU predicts; velocity, field and (where GPS is missing) gravity correct."""
        _, _, state = self.update_block(block_of(reading), state)
        return AttitudeEstimate(state.t_us, state.x[:4]), state

    def update_block(self, block: Block, state: EkfState) -> tuple[Stamps, Vector, EkfState]:
        """Update with a block: stamps (m,) and q_nb (m, 4) after each IMU sample, next state."""
        stamps = np.array([state.t_us, state.gps_t_us, state.tilt_t_us])
        t_us, q_nb, x, stamps, airspeed_mps = ekf_kernel.filter_block(
            block.kind,
            block.t_us,
            block.values,
            state.x,
            stamps,
            state.airspeed_mps,
            state.declination_rad,
            self.tuning,
        )
        now_us, gps_t_us, tilt_t_us = stamps.tolist()
        after = EkfState(now_us, x, airspeed_mps, state.declination_rad, gps_t_us, tilt_t_us)
        return t_us, q_nb, after
