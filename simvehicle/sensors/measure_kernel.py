"""Sampling of the compiled sensors that are due."""

from mavproxy_fault.numerics.compile import compiled
from simvehicle.sensors.airspeed import measure_airspeed
from simvehicle.sensors.barometer import measure_pressure
from simvehicle.sensors.compiled_sensor import BARO, IMU, MAG
from simvehicle.sensors.error_model import BLOCK
from simvehicle.sensors.flight_record import Records
from simvehicle.sensors.imu import measure_imu
from simvehicle.sensors.magnetometer import measure_field


@compiled
def measure(flight: Records, sensors: Records) -> None:
    """Sample the sensors that are due at the flight's state, and mark their values as fresh."""
    f = flight[0]
    for at in range(sensors.shape[0]):
        s = sensors[at]
        s.fresh = 0
        if f.t_us < s.due_us:
            continue
        if s.kind == IMU:
            measure_imu(f, s)
        elif s.kind == MAG:
            measure_field(f, s)
        elif s.kind == BARO:
            measure_pressure(f, s)
        else:
            measure_airspeed(f, s)
        s.fresh = 1
        s.row += 1
        if s.row == BLOCK:
            f.used_up = 1
        s.count += 1
        # From the count: a period that is no integer number of microseconds must not drift.
        s.due_us = s.count * 1e6 / s.rate_hz
