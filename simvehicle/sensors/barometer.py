"""Absolute pressure and air temperature."""

from typing import Any, ClassVar

from mavproxy_fault.numerics.compile import inlined
from simvehicle.environment.air import SEA_LEVEL_K, pressure_altitude
from simvehicle.environment.geolocation import AIR
from simvehicle.sensors.compiled_sensor import BARO, CompiledSensor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flight_record import WARMING
from simvehicle.sensors.sensor import Rate

CELSIUS_ZERO_K = 273.15


class Barometer(CompiledSensor, frozen=True, kw_only=True):
    """Measures static pressure [Pa]; the altitude is that of the standard atmosphere.

    It drifts with its temperature by `drift_pa_per_k`, relative to 15 degrees Celsius; that is the
    air's and the plant fault `sensor_warming_k`.
    """

    channels: ClassVar = {"noise": 1}
    kind: ClassVar = BARO
    constants: ClassVar = ("drift_pa_per_k",)

    rate_hz: Rate = 50.0
    noise: NoiseModel = NoiseModel()
    drift_pa_per_k: float = 0.0


@inlined
def measure_pressure(flight: Any, sensor: Any) -> None:
    """Sample pressure [Pa], its altitude [m] and temperature [degrees Celsius] into `values`."""
    kelvin = flight.here[AIR + 1] + flight.disturbance[WARMING]
    error = sensor.errors[sensor.row, 0]
    drift = sensor.constants[0] * (kelvin - SEA_LEVEL_K)
    pressure = (1.0 + sensor.scale[0]) * flight.here[AIR] + error + drift
    sensor.values[0] = pressure
    # A large bias may make the pressure negative, where the altitude is undefined.
    sensor.values[1] = pressure_altitude(max(pressure, 1.0))
    sensor.values[2] = kelvin - CELSIUS_ZERO_K
