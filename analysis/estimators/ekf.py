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

import numpy as np

from analysis.estimators import ekf_kernel
from analysis.estimators.estimator import KernelEstimator, KernelState, Prior


@dataclass(frozen=True)
class Ekf(KernelEstimator):
    """The noise that it assumes, and one sigma of its first attitude, bias and velocity."""

    tuning: ekf_kernel.Tuning = field(default=ekf_kernel.Tuning())
    start_sigma: tuple[float, float, float] = (0.05, 0.05, 0.5)  # rad, rad/s, m/s
    filter_block = staticmethod(ekf_kernel.filter_block)

    def start(self, prior: Prior) -> KernelState:
        """The prior with `start_sigma`; GPS counts as missing until its first fix.

        x (91,) is q_nb, bias in rad/s, velocity NED in m/s, and the covariance (9, 9) by rows.
        """
        # The same for the three axes of each error.
        sigma = np.repeat(self.start_sigma, 3)
        # The bias is unknown at start, so that it begins at zero with its sigma.
        x = np.concatenate([prior.q_nb, np.zeros(3), prior.v_ned_mps, np.diag(sigma**2).ravel()])
        # The last velocity counts as timed out: gravity is used until the first GPS fix.
        timed_out_us = prior.t_us - round(self.tuning.gps_timeout_s * 1e6)
        stamps = np.array([prior.t_us, timed_out_us, prior.t_us])
        return KernelState(x, stamps, 0.0, prior.declination_rad)
