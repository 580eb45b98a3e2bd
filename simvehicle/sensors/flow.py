"""Optical flow of a camera that looks down along the body's z axis, over level ground.

Sign convention of MAVLink's OPTICAL_FLOW_RAD and HIL_OPTICAL_FLOW: the flow is the image's turn
about the body's x and y axes as a gyro would show it, so turning the camera without moving gives
flow equal to the gyro's share.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simvehicle.body import Truth
from simvehicle.readings import FlowReading
from simvehicle.rotation import into_body
from simvehicle.sensors.base import SensorParameters
from simvehicle.sensors.noise import Noise, NoiseState
from simvehicle.sensors.rangefinder import slant_range


class FlowState(NamedTuple):
    """Noise of flow and gyro."""

    flow: NoiseState
    gyro: NoiseState


class OpticalFlow(SensorParameters, frozen=True, kw_only=True):
    """Measures angular image motion [rad/s], integrated over one sample's time."""

    rate_hz: float = 20.0
    flow: Noise = Noise()
    gyro: Noise = Noise()
    min_m: float = 0.1
    max_m: float = 40.0

    def new_state(self, rng: np.random.Generator) -> FlowState:
        """Draw the constant errors."""
        rate = self.rate_hz
        return FlowState(self.flow.new_state(rng, 2, rate), self.gyro.new_state(rng, 3, rate))

    def sample(
        self, truth: Truth, state: FlowState, rng: np.random.Generator
    ) -> tuple[FlowReading, FlowState]:
        """One reading; quality is 0 where the ground is out of range."""
        flow_error, flow_state = self.flow.next(state.flow, rng, self.rate_hz)
        gyro_error, gyro_state = self.gyro.next(state.gyro, rng, self.rate_hz)
        dt = 1.0 / self.rate_hz
        distance = slant_range(truth)
        seen = self.min_m <= distance <= self.max_m
        flow: NDArray[np.float64] = np.zeros(2)
        if seen:
            vx, vy, _ = into_body(truth.q_nb, truth.v_ned_mps).tolist()
            p, q, _ = truth.omega_b_rps.tolist()
            flow = np.array([p - vy / distance, q + vx / distance])
            flow = ((1.0 + self.flow.scale) * flow + flow_error) * dt
        gyro = (truth.omega_b_rps + gyro_error) * dt
        shown = distance if seen else -1.0
        quality = 255 if seen else 0
        reading = FlowReading(truth.t_us, dt, flow, gyro, shown, quality)
        return reading, FlowState(flow_state, gyro_state)
