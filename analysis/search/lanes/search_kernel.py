"""Many flights at once: truth, sensors, faults, estimator and scores, compiled.

`fly` takes flights as the columns of an array whose rows are those of `rows`, works through them
in groups of LANES and leaves the scores in the same rows.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.search.lanes import rows
from analysis.search.lanes.aid_lanes import airspeeds, sense_field, sense_pressure, sense_velocity
from analysis.search.lanes.fault_lanes import break_signals
from analysis.search.lanes.filter_lanes import Tunings, filter_step, publish
from analysis.search.lanes.gust_lanes import blow
from analysis.search.lanes.heun_lanes import attitudes, heun, keep
from analysis.search.lanes.inverted_lanes import (
    Place,
    score_place,
    score_pressures,
    sense_place,
    sense_static,
)
from analysis.search.lanes.lane_state import (
    Buffer,
    Envelope,
    Three,
    draw,
    gather,
    living,
    move,
    sense_imu,
)
from analysis.search.lanes.quad_lanes import QuadModel, move_quad, steer_quad
from analysis.search.lanes.score_lanes import (
    euler_of_quaternions,
    score_angle,
    score_euler,
    score_state,
)
from analysis.search.lanes.steer_lanes import steer
from mavproxy_fault.numerics.compile import compiled
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.rigidbody_kernel import Inertia

L = rows.LANES
IMU = 0
TRUE_SIZE = 13 + rows.CHANNELS  # true state and measurements of a traced sample
FIELD = rows.FIELD - rows.MEASURED
VELOCITY = rows.VELOCITY - rows.MEASURED
PRESSURE = rows.DIFF_PRESSURE - rows.MEASURED
PLACE = rows.PLACE - rows.MEASURED
Columns = NDArray[np.float64]
Generators = NDArray[np.uint64]


class Plan(NamedTuple):
    """The parameters that all flights of a test share; every field is a number, as numba needs.

    `estimator` is 0 for the inverse sensor model, 1 for Mahony, 2 for the EKF; `field_every`,
    `velocity_every` and `pressure_every` count IMU samples. With `inverted` height, airspeed and
    position are made of the pressures and of GPS, and scored. With `rotors` a `quad` flies, else
    the fixed wing of `aero`.
    """

    steps: int
    dt_s: float
    gravity_mps2: float
    density_kgpm3: float
    field_ned_gauss: Three
    declination_rad: float
    field_every: int
    velocity_every: int
    pressure_every: int
    mission: bool
    gusts: bool
    gust_sigma_mps: Three
    gust_length_m: Three
    slots: int
    noisy: bool
    angle: bool
    state: bool
    inverted: bool
    place: Place
    estimator: int
    tunings: Tunings
    sea_density_kgpm3: float
    limits: Envelope
    body: Inertia
    aero: Aero
    rotors: bool
    quad: QuadModel


@compiled
def break_all(buf: Buffer, first: int, last: int, k: int, plan: Plan) -> None:
    """The faults of all slots on some channels."""
    for slot in range(plan.slots):
        break_signals(buf, slot, first, last, k * plan.dt_s)


@compiled
def measure(buf: Buffer, generators: Generators, k: int, plan: Plan) -> None:
    """The sensors' samples number `k`, with faults; the slow ones' first is due after a period.

    Generators (4, LANES): IMU, slow sensors, noise faults, gusts.
    """
    slow = (plan.estimator > 0 or plan.inverted) and k > 0
    pressure = slow and k % plan.pressure_every == 0
    pitot = pressure and not plan.rotors
    field = slow and k % plan.field_every == 0
    velocity = slow and k % plan.velocity_every == 0
    draw(buf, generators[0])
    sense_imu(buf)
    if pressure:
        draw(buf, generators[1])
        sense_static(buf, plan.place)
    if pitot:
        sense_pressure(buf, plan.density_kgpm3)
    if field or velocity:
        draw(buf, generators[1])
    if field:
        sense_field(buf, plan.field_ned_gauss)
    if velocity:
        sense_velocity(buf)
    if plan.noisy:
        draw(buf, generators[2])
    break_all(buf, IMU, IMU + 6, k, plan)
    if pressure:
        break_all(buf, PRESSURE, PRESSURE + 2, k, plan)
    if field:
        break_all(buf, FIELD, FIELD + 3, k, plan)
    if velocity:
        break_all(buf, VELOCITY, VELOCITY + 3, k, plan)
    if plan.inverted and velocity:
        sense_place(buf, generators[1], plan.place, k == plan.velocity_every)
        break_all(buf, PLACE, PLACE + 3, k, plan)
    if plan.inverted and pressure:
        score_pressures(buf, plan.place)
    if plan.inverted and velocity:
        score_place(buf)


@compiled
def tick(
    buf: Buffer,
    filters: Columns,
    airspeed: Buffer,
    generators: Generators,
    k: int,
    plan: Plan,
) -> None:
    """Sample `k` of every lane: truth, sensors, estimate, score; the truth moves on."""
    world = (plan.gravity_mps2, plan.density_kgpm3)
    if plan.rotors:
        steer_quad(buf, k * plan.dt_s, world, plan.quad.control)
        move_quad(buf, plan.dt_s, world, plan.body, plan.quad, plan.limits)
    else:
        if plan.mission:
            steer(buf, k * plan.dt_s)
        move(buf, plan.dt_s, world, plan.body, plan.aero, plan.limits)
    measure(buf, generators, k, plan)
    if plan.estimator == 0:
        if k > 0:
            heun(buf, plan.dt_s)
        keep(buf)
        if plan.angle:
            attitudes(buf)
        if plan.state:
            score_state(buf)
    else:
        if k > 0:
            filter_step(buf, filters, airspeed, k, plan)
            if k % plan.pressure_every == 0 and not plan.rotors:
                airspeeds(buf, airspeed, plan.sea_density_kgpm3)
        publish(buf, filters)
        euler_of_quaternions(buf)
    score_euler(buf)
    if plan.angle:
        score_angle(buf)
    if plan.gusts:
        draw(buf, generators[3])
        blow(buf, plan.gust_sigma_mps, plan.gust_length_m, plan.dt_s)


@compiled
def fly(
    flights: Columns, filters: Columns, generators: Generators, plan: Plan, traced: Columns
) -> None:
    """Fly all columns of `flights` (ROWS, n), n a multiple of LANES.

    `filters` (n, FILTER_SIZE) holds the filters' start states, `generators` (4, n) the noise.
    `traced` takes the samples of the first lane of a group, unless it is empty: 13 of the true
    state, CHANNELS measured, 9 of ESTIMATE and 4 of QUATERNION, whether alive.
    """
    buf = np.empty(rows.ROWS * L)
    for first in range(0, flights.shape[1], L):
        for row in range(rows.ROWS):
            buf[row * L : row * L + L] = flights[row, first : first + L]
        states = filters[first : first + L]
        noise = generators[:, first : first + L].copy()
        airspeed = np.zeros(L)
        for k in range(plan.steps + 1):
            tick(buf, states, airspeed, noise, k, plan)
            if len(traced):
                traced[k, :13] = gather(buf, rows.NOW * L, 13, 0)
                traced[k, 13 : 13 + rows.CHANNELS] = gather(
                    buf, rows.MEASURED * L, rows.CHANNELS, 0
                )
                traced[k, 13 + rows.CHANNELS : -1] = gather(buf, rows.ESTIMATE * L, 13, 0)
                traced[k, -1] = buf[rows.ALIVE * L]
            elif k % 64 == 0 and living(buf) == 0:
                break
        for row in range(rows.ROWS):
            flights[row, first : first + L] = buf[row * L : row * L + L]
