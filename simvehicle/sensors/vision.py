"""Pose and velocity as visual odometry or motion capture gives them."""

from typing import NamedTuple

import numpy as np

from simvehicle.body import Truth
from simvehicle.readings import VisionReading
from simvehicle.rotation import quat_from_rotvec, quat_multiply
from simvehicle.sensors.base import SensorParameters
from simvehicle.sensors.noise import Noise, NoiseState


class VisionState(NamedTuple):
    """Noise of position, velocity and attitude."""

    position: NoiseState
    velocity: NoiseState
    attitude: NoiseState


class Vision(SensorParameters, frozen=True, kw_only=True):
    """Measures position [m] and velocity [m/s] in local NED and attitude (errors in rad).

    A random walk of the position is what visual odometry without loop closure does.
    """

    rate_hz: float = 30.0
    position: Noise = Noise()
    velocity: Noise = Noise()
    attitude: Noise = Noise()

    def new_state(self, rng: np.random.Generator) -> VisionState:
        """Draw the constant errors."""
        rate = self.rate_hz
        return VisionState(
            self.position.new_state(rng, 3, rate),
            self.velocity.new_state(rng, 3, rate),
            self.attitude.new_state(rng, 3, rate),
        )

    def sample(
        self, truth: Truth, state: VisionState, rng: np.random.Generator
    ) -> tuple[VisionReading, VisionState]:
        """One reading."""
        rate = self.rate_hz
        place, position = self.position.next(state.position, rng, rate)
        speed, velocity = self.velocity.next(state.velocity, rng, rate)
        tilt, attitude = self.attitude.next(state.attitude, rng, rate)
        reading = VisionReading(
            truth.t_us,
            (1.0 + self.position.scale) * truth.r_ned_m + place,
            (1.0 + self.velocity.scale) * truth.v_ned_mps + speed,
            quat_multiply(truth.q_nb, quat_from_rotvec(tilt)),
            max(self.position.sigma, 0.01),
            max(self.velocity.sigma, 0.01),
        )
        return reading, VisionState(position, velocity, attitude)
