"""Battery monitor: voltage and current of the pack, and its exact remaining charge."""

from typing import ClassVar

from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.readings import BatteryReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


class BatteryMonitor(SensorParameters, frozen=True, kw_only=True):
    """Measures voltage [V] and current [A]."""

    channels: ClassVar = {"voltage": 1, "current": 1}

    rate_hz: Rate = 2.0
    voltage: NoiseModel = NoiseModel()
    current: NoiseModel = NoiseModel()

    def measure(self, truth: Truth, *errors: list[float]) -> BatteryReading:
        """One reading."""
        voltage, current = errors
        return BatteryReading(
            truth.t_us,
            (1.0 + self.voltage.scale) * truth.battery_v + voltage[0],
            (1.0 + self.current.scale) * truth.battery_a + current[0],
            # Exact: the gauge uses the model's charge, not this sensor's current.
            truth.battery_remaining,
        )
