"""The IMU: gyros and accelerometers of three axes each, sampled together."""

from typing import Any, ClassVar

from mavproxy_fault.numerics.compile import inlined
from simvehicle.sensors.compiled_sensor import IMU, CompiledSensor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flight_record import WARMING
from simvehicle.sensors.sensor import Rate
from simvehicle.vehicles.rigidbody_kernel import P
from simvehicle.vehicles.vehicle import FORCE

Triple = tuple[float, float, float]


class ImuSensor(CompiledSensor, frozen=True, kw_only=True):
    """Measures body rates [rad/s] and specific force [m/s^2], saturated at the ranges.

    `gyro_per_k` [rad/s/K] and `accel_per_k` [m/s^2/K] are the errors of each axis per kelvin that
    the sensor is warmer than at its calibration (plant fault `sensor_warming_k`).
    """

    channels: ClassVar = {"gyro": 3, "accel": 3}
    kind: ClassVar = IMU
    constants: ClassVar = ("gyro_range_rps", "accel_range_mps2", "gyro_per_k", "accel_per_k")

    rate_hz: Rate = 250.0
    gyro: NoiseModel = NoiseModel()
    accel: NoiseModel = NoiseModel()
    gyro_range_rps: float = 35.0  # 2000 deg/s and 16 g, the usual MEMS IMU settings of autopilots
    accel_range_mps2: float = 160.0
    gyro_per_k: Triple = (0.0, 0.0, 0.0)
    accel_per_k: Triple = (0.0, 0.0, 0.0)


@inlined
def measure_imu(flight: Any, sensor: Any) -> None:
    """Sample specific force [m/s^2], then body rates [rad/s], into `values`."""
    rates = (flight.x[P], flight.x[P + 1], flight.x[P + 2])
    force = (flight.load[FORCE], flight.load[FORCE + 1], flight.load[FORCE + 2])
    row, scale, limit = sensor.errors[sensor.row], sensor.scale, sensor.constants
    gyro = apply_triad_errors(rates, scale[0], warmed_errors(flight, row, limit, 0), limit[0])
    accel = apply_triad_errors(force, scale[1], warmed_errors(flight, row, limit, 3), limit[1])
    for i in range(3):
        sensor.values[i] = accel[i]
        sensor.values[3 + i] = gyro[i]


@inlined
def warmed_errors(flight: Any, row: Any, constants: Any, at: int) -> Triple:
    """The errors of three channels of `row` from `at` on, with those of the warming."""
    warming, per_k = flight.disturbance[WARMING], constants[2 + at :]
    return (
        row[at] + warming * per_k[0],
        row[at + 1] + warming * per_k[1],
        row[at + 2] + warming * per_k[2],
    )


@inlined
def apply_triad_errors(true: Triple, scale: float, error: Triple, limit: float) -> Triple:
    """A triad with scale and error, saturated at its range."""
    x, y, z = true
    a, b, c = error
    gain = 1.0 + scale
    x, y, z = gain * x + a, gain * y + b, gain * z + c
    return (
        min(limit, max(-limit, x)), min(limit, max(-limit, y)), min(limit, max(-limit, z)),
    )  # fmt: skip
