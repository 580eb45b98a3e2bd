"""The swaying controller of a quadrotor, used instead of a mission."""

import math

import numpy as np

from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from simvehicle.guidance.multirotor_controller import MultirotorController
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.multirotor.sway_kernel import (
    HEIGHT,
    MOTOR_COUNT,
    sway_commands,
    sway_plan,
)


class SwayController(MultirotorController):
    """Rolls from side to side at its initial height; with a track it becomes a path controller.

    `aim` is the roll amplitude [rad], its period [s] and the pitch [rad]; `plan` is that of
    `sway_commands`, with the height from the first update.
    """

    rate_hz = math.inf  # updates at every step

    def __init__(
        self, vehicle: Multirotor, home_alt_m: float, aim: tuple[float, float, float]
    ) -> None:
        super().__init__(vehicle, home_alt_m)
        self.plan = sway_plan(vehicle, aim, math.nan)

    def update(self, truth: Truth) -> Controls:
        """Controls for the next step."""
        if self.track is not None or self.landing:
            self.rate_hz = MultirotorController.rate_hz
            return super().update(truth)
        height_m = -float(truth.r_ned_m[2])
        if math.isnan(self.plan[HEIGHT]):
            self.plan[HEIGHT] = height_m
        commands = np.empty(MOTOR_COUNT)
        sway_commands(
            truth.t_us * 1e-6, truth.q_nb, truth.omega_b_rps, height_m, -float(truth.v_ned_mps[2]),
            truth.density_kgpm3 / SEA_LEVEL_DENSITY_KGPM3, self.plan, commands,
        )  # fmt: skip
        return Controls(commands)
