"""A step of the simulation, compiled: the next step's inputs, the flight, the arrival."""

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled
from simvehicle.environment.air import step_wind
from simvehicle.environment.geolocation import (
    AIR,
    AIR_VELOCITY,
    GEOID,
    LOCAL_GRAVITY,
    LOCATION_SIZE,
    locate_state,
)
from simvehicle.sensors.airspeed import measure_airspeed
from simvehicle.sensors.barometer import measure_pressure
from simvehicle.sensors.compiled_sensor import BARO, IMU, MAG
from simvehicle.sensors.error_model import BLOCK
from simvehicle.sensors.flight_record import Records
from simvehicle.sensors.imu import measure_imu
from simvehicle.sensors.magnetometer import measure_field
from simvehicle.vehicles.fixedwing import fixedwing_flight
from simvehicle.vehicles.multirotor import multirotor_flight
from simvehicle.vehicles.rigidbody_kernel import DOWN
from simvehicle.vehicles.vehicle import pack_surroundings

LONGEST_STEP_S = 0.005  # ground contact is stiff: 40 rad/s needs steps of a few ms


@compiled
def prepare(flight: Records) -> None:
    """Compute the part of the next step that does not depend on its commands, once."""
    f = flight[0]
    if f.prepared:
        return
    f.prepared = 1
    # From the count: summing a period of 3.33 ms would drift.
    f.next_us = np.int64(np.rint(f.count * 1e6 / f.rate_hz))
    f.count += 1
    dt = (f.next_us - f.t_us) * 1e-6
    f.row += 1
    if f.row == BLOCK - 1:
        f.used_up = 1
    here = f.here
    # Constant over the step, as gusts are slow in comparison.
    air = here[AIR_VELOCITY:LOCAL_GRAVITY]
    step_wind(f.filters, f.draws[f.row], f.weather, f.x, air, f.agl_m, dt, f.next_wind)
    gravity = here[LOCAL_GRAVITY:LOCATION_SIZE]
    pack_surroundings(f.next_wind, gravity, here[AIR + 2], f.x[DOWN] + f.agl_m, f.around)
    # Divide long steps, so that a slow IMU does not make the integration coarse.
    f.substeps = max(1, int(np.ceil(dt / LONGEST_STEP_S - 1e-9)))
    f.dt = dt / f.substeps


@compiled
def locate(flight: Records) -> bool:
    """Locate the state; False if it has diverged, as the height depends on all of it."""
    f = flight[0]
    locate_state(f.x, f.wind, f.home, f.here)
    f.agl_m = f.here[2] - f.home[GEOID] - f.ground_m
    return bool(np.isfinite(f.here[2]))


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


@compiled
def arrive(flight: Records, sensors: Records) -> bool:
    """End the prepared step at the state that was flown to; False if that has diverged."""
    f = flight[0]
    f.t_us, f.prepared = f.next_us, 0
    for i in range(3):
        f.wind[i] = f.next_wind[i]
    if not locate(flight):
        return False
    measure(flight, sensors)
    return True


@compiled
def step(flight: Records, sensors: Records, packed: Array) -> bool:
    """Fly one step of a vehicle with the `packed` parameters; False if its state has diverged."""
    prepare(flight)
    f = flight[0]
    x, after = f.x[: f.states], f.after[: f.states]
    # Slices have the type of arrays from Python: one compiled form of each flight.
    controls, around, load = f.controls[: f.actuators], f.around[:], f.load[:]
    if f.wing:
        fixedwing_flight.integrate_flight(
            x, controls, around, f.substeps, f.dt, packed, after, load
        )
    else:
        multirotor_flight.integrate_flight(
            x, controls, around, f.substeps, f.dt, packed, after, load
        )
    for i in range(f.states):
        x[i] = after[i]
    return arrive(flight, sensors)
