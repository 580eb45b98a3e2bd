"""Receiver of a remote control whose pilot leaves the sticks alone."""

from simvehicle.sensors.readings import RemoteControlReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth

CENTRED_US = (1500,) * 8


class RemoteControl(SensorParameters, frozen=True, kw_only=True):
    """Sends the pulse widths of eight centred channels, as in flight under an autopilot."""

    rate_hz: Rate = 10.0  # PX4 reports a loss after 0.5 s, ArduPilot after 1 s

    def measure(self, truth: Truth, *errors: list[float]) -> RemoteControlReading:
        """One reading."""
        return RemoteControlReading(truth.t_us, CENTRED_US)
