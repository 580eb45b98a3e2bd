"""Pitot tube: the differential pressure of the airspeed."""

from typing import Any, ClassVar

from mavproxy_fault.numerics.compile import inlined
from simvehicle.environment.geolocation import AIR, AIR_VELOCITY
from simvehicle.sensors.compiled_sensor import PITOT, CompiledSensor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flight_record import WARMING
from simvehicle.sensors.sensor import Rate


class Airspeed(CompiledSensor, frozen=True, kw_only=True):
    """Measures rho/2 Va^2 [Pa], with Va the total airspeed as in Beard and McLain, section 7.4.

    Its zero drifts by `drift_pa_per_k` with the plant fault `sensor_warming_k`.
    """

    channels: ClassVar = {"noise": 1}
    kind: ClassVar = PITOT
    constants: ClassVar = ("drift_pa_per_k",)

    rate_hz: Rate = 50.0
    noise: NoiseModel = NoiseModel()
    drift_pa_per_k: float = 0.0

    def describe(self, record: Any) -> None:
        """Write the parameters to a record of `SENSOR`."""
        super().describe(record)
        record["id"] = 0  # HIL_SENSOR has one pitot tube


@inlined
def measure_airspeed(flight: Any, sensor: Any) -> None:
    """Sample the differential pressure [Pa] into `values`."""
    here = flight.here
    u, v, w = here[AIR_VELOCITY], here[AIR_VELOCITY + 1], here[AIR_VELOCITY + 2]
    pressure = 0.5 * here[AIR + 2] * (u * u + v * v + w * w)
    drift = sensor.constants[0] * flight.disturbance[WARMING]
    sensor.values[0] = (1.0 + sensor.scale[0]) * pressure + sensor.errors[sensor.row, 0] + drift
