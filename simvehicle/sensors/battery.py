"""Battery monitor: voltage and current of the pack, and its exact remaining charge."""

from typing import ClassVar, NamedTuple

import numpy as np

from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import BatteryReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class BatteryState(NamedTuple):
    """Noise of voltage and current."""

    voltage: NoiseState
    current: NoiseState


class BatteryMonitor(SensorParameters, frozen=True, kw_only=True):
    """Measures voltage [V] and current [A]."""

    channels: ClassVar = {"voltage": 1, "current": 1}

    rate_hz: float = 2.0
    voltage: NoiseModel = NoiseModel()
    current: NoiseModel = NoiseModel()

    def new_state(self, rng: np.random.Generator) -> BatteryState:
        """Draw the constant errors."""
        rate = self.rate_hz
        return BatteryState(
            self.voltage.new_state(rng, 1, rate), self.current.new_state(rng, 1, rate)
        )

    def sample(
        self, truth: Truth, state: BatteryState, rng: np.random.Generator
    ) -> tuple[BatteryReading, BatteryState]:
        """One reading."""
        v, voltage = self.voltage.next(state.voltage, rng, self.rate_hz)
        a, current = self.current.next(state.current, rng, self.rate_hz)
        reading = BatteryReading(
            truth.t_us,
            (1.0 + self.voltage.scale) * truth.battery_v + v[0],
            (1.0 + self.current.scale) * truth.battery_a + a[0],
            # Exact: the gauge uses the model's charge, not this sensor's current.
            truth.battery_remaining,
        )
        return reading, BatteryState(voltage, current)
