"""Three-axis magnetometer."""

from typing import Any, ClassVar

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.rotations.one_rotation import rotate_to_body
from simvehicle.environment.geolocation import ATTITUDE
from simvehicle.sensors.compiled_sensor import MAG, CompiledSensor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flight_record import COMPASS
from simvehicle.sensors.imu import apply_triad_errors
from simvehicle.sensors.sensor import Rate
from simvehicle.vehicles.vehicle import CURRENT

_to_body = inlined(rotate_to_body)


class Magnetometer(CompiledSensor, frozen=True, kw_only=True):
    """Measures the Earth's field in body axes [gauss].

    `field_ned_gauss` is the field at home; over some kilometres it changes by less than the noise.
    By default the simulation fills in the value of the world magnetic model. The battery's current
    adds its field, linear in the current (Biot-Savart), by the plant fault `compass_*_gauss_per_a`.
    """

    channels: ClassVar = {"noise": 3}
    kind: ClassVar = MAG
    constants: ClassVar = ("field_ned_gauss",)

    rate_hz: Rate = 50.0
    noise: NoiseModel = NoiseModel()
    field_ned_gauss: tuple[float, float, float] | None = None


@inlined
def measure_field(flight: Any, sensor: Any) -> None:
    """Sample the field in body axes [gauss] into `values`."""
    e0, e1, e2, e3 = ATTITUDE, ATTITUDE + 1, ATTITUDE + 2, ATTITUDE + 3
    here, field, row = flight.here, sensor.constants, sensor.errors[sensor.row]
    true = _to_body((here[e0], here[e1], here[e2], here[e3]), (field[0], field[1], field[2]))
    seen = apply_triad_errors(true, sensor.scale[0], (row[0], row[1], row[2]), np.inf)
    for i in range(3):
        sensor.values[i] = seen[i] + flight.load[CURRENT] * flight.disturbance[COMPASS + i]
