"""Receiver of a remote control whose pilot leaves the sticks alone."""

import numpy as np

from simvehicle.sensors.error_model import NoiseState
from simvehicle.sensors.readings import RemoteControlReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class RemoteControl(SensorParameters, frozen=True, kw_only=True):
    """Pulse widths [us] of the channels; all centred, as in flight under an autopilot."""

    rate_hz: float = 10.0  # PX4 reports a loss after 0.5 s, ArduPilot after 1 s
    channels_us: tuple[int, ...] = (1500,) * 8

    def sample(
        self, truth: Truth, state: list[NoiseState], rng: np.random.Generator
    ) -> tuple[RemoteControlReading, list[NoiseState]]:
        """One reading."""
        return RemoteControlReading(truth.t_us, self.channels_us), state
