"""A flight in the simulator whose samples go to an estimator as arrays, without frames and proxy.

Steps between samples of sensors in Python are one compiled loop. Truth and samples are those of a
`run` of the same scenario and seed, before they are rounded in frames.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.estimators import Prior
from analysis.estimators.estimator import KernelState
from analysis.estimators.inverse_model import BEFORE, NINE, integrate_block
from analysis.samples.block import (
    FIX,
    FIX_3D,
    IMU,
    IMU_ID,
    RATES,
    SOURCES,
    WIDTH,
    Block,
    Indices,
    Stamps,
)
from analysis.samples.block import FORCE as FORCE_ROW
from analysis.search.evaluation.envelope import pack_envelope, violated_limit
from analysis.search.space.airframe import has_rotors
from analysis.search.space.test_file import FlightEnvelope, TestFile
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors
from simvehicle.environment.geolocation import AIR as LOCAL_AIR
from simvehicle.environment.geolocation import (
    AIR_VELOCITY,
    ATTITUDE,
    GEOID,
    LOCAL_GRAVITY,
    VELOCITY,
)
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.error_model import BLOCK
from simvehicle.sensors.flight_record import Records
from simvehicle.simulation.onboard_sensors import OnboardSensor
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.step_kernel import step
from simvehicle.vehicles.fixedwing.weave_kernel import weave_controls
from simvehicle.vehicles.multirotor.sway_kernel import sway_commands
from simvehicle.vehicles.rigidbody_kernel import DOWN, E0, RIGID_SIZE, P

# Columns of the truth, after the rigid body's state: velocity through the air (body axes), specific
# force, height above ground, and latitude [rad], longitude [rad], height [m].
AIR, FORCE, HEIGHT, PLACE, TRUTH_SIZE = RIGID_SIZE, 16, 19, 20, 23
LIMIT = 3  # index in the counts of `record_steps`
HEAD = 2  # columns of a row before the values
GPS_SOURCE = SOURCES.index("HIL_GPS")


class SampledFlight(NamedTuple):
    """A flight as far as it is within the envelope, and the sample at which a `limit` ended it.

    `truth` (n, TRUTH_SIZE) at its n IMU samples, all samples in order, and the truth at the first
    of them as `prior`, without declination.
    """

    truth: Array
    samples: Block
    limit: int
    prior: Prior


# The truth, the samples' rows (m, HEAD + WIDTH): kind, stamp and values, and counts (4,): the rows
# in use of both, the number of fixes, and the limit that is violated.
Room = tuple[Array, Array, Indices]


@compiled
def record_steps(
    flight: Records, sensors: Records, packed: Array, plan: Array, end_us: int, fix_hz: float,
    limits: Array, room: Room,
) -> bool:  # fmt: skip
    """Fly and record steps until a time, the limits of `violated_limit`, or the end of the random
    draws; controls are constant without a `plan`. False if the state has diverged."""
    f, (truth, _, counts) = flight[0], room
    while f.t_us < end_us and not f.used_up and not counts[LIMIT]:
        if len(plan):
            steer(flight, plan)
        if not step(flight, sensors, packed):
            return False
        row = truth[counts[0]]
        row[:RIGID_SIZE] = f.x[:RIGID_SIZE]
        row[AIR:FORCE] = f.here[AIR_VELOCITY:LOCAL_GRAVITY]
        row[FORCE:HEIGHT] = f.load[:3]
        row[HEIGHT] = f.agl_m
        row[PLACE:] = f.here[:3]
        counts[0] += 1
        record_samples(flight, sensors, fix_hz, room)
        # The first sample beyond is the last one that counts.
        counts[LIMIT] = violated_limit(
            row[E0:P], row[AIR:FORCE], row[P:RIGID_SIZE], row[FORCE:HEIGHT], f.agl_m, limits
        )
    return True


@compiled
def steer(flight: Records, plan: Array) -> None:
    """Set the controls of the next step by the plan of `weave_controls` or `sway_commands`."""
    f = flight[0]
    here, t_s, rates, controls = f.here, f.t_us * 1e-6, f.x[P:RIGID_SIZE], f.controls[:4]
    attitude, air = here[ATTITUDE:AIR_VELOCITY], here[AIR_VELOCITY:LOCAL_GRAVITY]
    if f.wing:
        weave_controls(t_s, attitude, rates, air, plan, controls)
    else:
        ratio = here[LOCAL_AIR + 2] / SEA_LEVEL_DENSITY_KGPM3
        climb_mps = -here[VELOCITY + 2]
        sway_commands(t_s, attitude, rates, -f.x[DOWN], climb_mps, ratio, plan, controls)


@compiled
def record_samples(flight: Records, sensors: Records, fix_hz: float, room: Room) -> None:
    """Append the samples of a step, whose kinds are those of sensors, and of a GPS what it
    measures: position [rad, m], height above sea level, velocity."""
    f, (_, rows, counts) = flight[0], room
    m = counts[1]
    for at in range(sensors.shape[0]):
        if sensors[at].fresh:
            values, seen = rows[m, HEAD:], sensors[at].values
            rows[m, 0], rows[m, 1] = sensors[at].kind, f.t_us
            values[:6] = seen
            if sensors[at].kind == IMU:  # has the specific force first
                values[RATES:FORCE_ROW], values[FORCE_ROW:IMU_ID] = seen[3:], seen[:3]
            m += 1
    if f.t_us >= (counts[2] + 1) * 1e6 / fix_hz:
        values = rows[m, HEAD:]
        rows[m, 0], rows[m, 1] = FIX, f.t_us
        values[:3], values[3] = f.here[:3], f.here[2] - f.home[GEOID]
        values[4:7] = f.here[VELOCITY : VELOCITY + 3]
        counts[2] += 1
        m += 1
    counts[1] = m


@lru_cache(maxsize=8)  # cells of a campaign and reduced faults share a flight
def fly_sampled(document: bytes, envelope: FlightEnvelope, hovers: bool) -> SampledFlight:
    """Fly a scenario (JSON) with one IMU and GPS until it ends, leaves the envelope or diverges."""
    scenario = msgspec.json.decode(document, type=Scenario)
    simulation, end_us = Simulation(scenario), round(scenario.duration_s * 1e6)
    flight, sensors = simulation.board
    packed, (gps,) = simulation.packed, simulation.onboard_sensors
    assert packed is not None
    controller: Any = simulation.controller
    now, steps = flight[0], int(scenario.duration_s * float(flight[0]["rate_hz"])) + 2
    truth, counts = np.empty((steps, TRUTH_SIZE)), np.zeros(4, np.int64)
    rows = np.zeros((steps * (len(sensors) + 1), HEAD + WIDTH))
    limits, fix_hz, finite = pack_envelope(envelope, hovers), gps.sensor.rate_hz, True
    room = (truth, rows, counts)
    commands, plan = simulation.commanded(), controller.plan
    now["controls"][: len(commands)] = commands
    while finite and not counts[LIMIT] and now["t_us"] < end_us:
        simulation.prepare()
        finite = record_steps(flight, sensors, packed, plan, end_us, fix_hz, limits, room)
    rows = rows[: counts[1]]
    _measure_fixes(gps, rows)
    kind, t_us = rows[:, :HEAD].T.astype(np.int64)
    samples = Block(kind, t_us, rows[:, HEAD:].copy(), {})
    truth = truth[: counts[0]]
    r_ned_m, v_b_mps, q_nb = np.split(truth[0, :10], [3, 6])
    prior = Prior(int(t_us[0]), q_nb, matrix_from_quat(q_nb) @ v_b_mps, r_ned_m)
    return SampledFlight(truth, samples, int(counts[LIMIT]), prior)


def _measure_fixes(gps: OnboardSensor, rows: Array) -> None:
    """Replace what a GPS measures by its fixes."""
    at = np.flatnonzero(rows[:, 0] == FIX)
    blocks = [np.hstack([noise.block for noise in gps.state.noises])]
    while len(at) > BLOCK * len(blocks):
        gps.state = gps.sensor.next_blocks(gps.state, gps.rng)
        blocks.append(np.hstack([noise.block for noise in gps.state.noises]))
    true, errors = rows[at, HEAD:].T, np.vstack(blocks)[: len(at)].T
    sensor = gps.sensor
    quality = [FIX_3D, sensor.satellites, sensor.eph_m, sensor.epv_m, GPS_SOURCE]
    rows[at, HEAD : HEAD + 6] = sensor.fixes(true[:4], true[4:7], errors).T
    rows[at, HEAD + 6 : HEAD + 11] = quality


def sampled_flight(test: TestFile, document: Mapping[str, Any]) -> SampledFlight:
    """The flight of a test's scenario, whatever its faults: they do not act on the controls."""
    bare = {key: value for key, value in document.items() if key not in ("schedule", "monitor")}
    return fly_sampled(msgspec.json.encode(bare), test.envelope, has_rotors(test.vehicle))


@compiled
def error_rows(q_nb: Array, truth: Array) -> Array:
    """Errors (n, 4) of attitudes (n, 4), as `attitude_errors` has them; pi where there is NaN."""
    out = np.empty((len(q_nb), 4))
    for i in range(len(q_nb)):
        for k, error in enumerate(attitude_errors(q_nb[i], truth[i])):
            out[i, k] = error if error == error else np.pi
    return out


@compiled
def nine_states(kind: Indices, t_us: Stamps, values: Array, state: KernelState) -> Array:
    """The nine states (n, 9) of the inverse model after each of n IMU samples of a block."""
    nine = np.empty((len(kind), BEFORE - NINE))
    for i in range(len(kind)):
        end = i + 1
        _, _, state = integrate_block(kind[i:end], t_us[i:end], values[i:end], state, None)
        nine[i] = state.x[NINE:BEFORE]
    return nine
