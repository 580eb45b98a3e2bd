"""The swaying controller of a quadrotor, used instead of a mission."""

import math

import numpy as np

from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from simvehicle.guidance.multirotor_controller import MultirotorController
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.multirotor.sway_kernel import (
    SwayFeedback,
    Three,
    quad_parameters,
    sway_commands,
)


class SwayController(MultirotorController):
    """Rolls from side to side at its initial height; with a track it becomes a path controller.

    `aim` is the roll amplitude [rad], its period [s] and the pitch [rad].
    """

    rate_hz = math.inf  # updates at every step

    def __init__(self, vehicle: Multirotor, home_alt_m: float, aim: Three) -> None:
        super().__init__(vehicle, home_alt_m)
        self._aim = aim
        self._quad = quad_parameters(vehicle)
        self._height_m: float | None = None

    def update(self, truth: Truth) -> Controls:
        """Controls for the next step."""
        if self.track is not None or self.landing:
            self.rate_hz = MultirotorController.rate_hz
            return super().update(truth)
        height_m = -float(truth.r_ned_m[2])
        if self._height_m is None:
            self._height_m = height_m
        roll, pitch, _ = euler_angles(truth.q_nb.tolist())
        p, q, r = truth.omega_b_rps.tolist()
        climb_mps = -float(truth.v_ned_mps[2])
        feedback = SwayFeedback(
            float(roll), float(pitch), (p, q, r), height_m - self._height_m, climb_mps
        )
        density_ratio = truth.density_kgpm3 / SEA_LEVEL_DENSITY_KGPM3
        t_s = truth.t_us * 1e-6
        return Controls(
            np.array(
                sway_commands(
                    feedback, self._aim, self._quad, STANDARD_GRAVITY_MPS2, density_ratio, t_s
                )
            )
        )
