"""A flight in the simulator whose samples go to an estimator as arrays, without frames and proxy.

Steps between samples of sensors in Python are one compiled loop. Truth and samples are those of a
`run` of the same scenario and seed, before they are rounded in frames.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.estimators import Prior, estimate_block, make_estimator
from analysis.estimators.inverse_model import BEFORE, NINE
from analysis.samples.block import FIX, IMU, IMU_ID, RATES, SOURCES, WIDTH, Block, Indices, Stamps
from analysis.samples.block import FORCE as FORCE_ROW
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors
from simvehicle.environment.geolocation import AIR_VELOCITY
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.flight_record import Records
from simvehicle.sensors.readings import GpsReading
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.step_kernel import prepare, step
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE

Array = NDArray[np.float64]
# Columns of the truth, after the rigid body's state: velocity through the air (body axes), specific
# force, height above ground, and latitude [rad], longitude [rad], height [m].
AIR, FORCE, HEIGHT, PLACE, TRUTH_SIZE = RIGID_SIZE, 16, 19, 20, 23
GPS_SOURCE = SOURCES.index("HIL_GPS")


class SampledFlight(NamedTuple):
    """A flight: `truth` (n, TRUTH_SIZE) at its n IMU samples, and all samples in order."""

    truth: Array
    samples: Block


class FlightRows(NamedTuple):
    """Room for a flight's truth and samples; `counts` (2,) are the rows that are used of each."""

    truth: Array
    kind: Indices
    t_us: Stamps
    values: Array
    counts: Indices


@compiled
def record_step(flight: Records, sensors: Records, out: FlightRows) -> None:
    """Append the truth and the fresh samples of a step; kinds of sensors and of rows are equal."""
    f, n = flight[0], out.counts[0]
    out.truth[n, :RIGID_SIZE] = f.x[:RIGID_SIZE]
    out.truth[n, AIR:FORCE] = f.here[AIR_VELOCITY : AIR_VELOCITY + 3]
    out.truth[n, FORCE:HEIGHT] = f.load[:3]
    out.truth[n, HEIGHT] = f.agl_m
    out.truth[n, PLACE:] = f.here[:3]
    out.counts[0] += 1
    for at in range(sensors.shape[0]):
        if sensors[at].fresh:
            m = out.counts[1]
            out.kind[m], out.t_us[m] = sensors[at].kind, f.t_us
            out.values[m, :6] = sensors[at].values
            if sensors[at].kind == IMU:  # has the specific force first
                out.values[m, RATES:FORCE_ROW] = sensors[at].values[3:]
                out.values[m, FORCE_ROW:IMU_ID] = sensors[at].values[:3]
            out.counts[1] += 1


@compiled
def record_steps(
    flight: Records, sensors: Records, packed: Array, quiet_us: int, out: FlightRows
) -> bool:
    """Fly and record steps with constant controls up to one that ends at `quiet_us` or later;
    False if the state has diverged."""
    while not flight[0].used_up:
        prepare(flight)
        if flight[0].next_us >= quiet_us:
            break
        if not step(flight, sensors, packed):
            return False
        record_step(flight, sensors, out)
    return True


@lru_cache(maxsize=4)  # cells of a campaign and reduced faults share a flight
def fly_sampled(document: bytes) -> SampledFlight:
    """Fly a scenario (JSON) with one IMU to its end, or until its state diverges."""
    scenario = msgspec.json.decode(document, type=Scenario)
    simulation, end_us = Simulation(scenario), round(scenario.duration_s * 1e6)
    flight, sensors = simulation.board
    packed, plan = simulation.packed, scenario.controls
    assert packed is not None
    assert plan is not None
    steps = int(scenario.duration_s * float(flight[0]["rate_hz"])) + 2
    rows = steps * (len(sensors) + 1)
    out = FlightRows(
        np.empty((steps, TRUTH_SIZE)), np.empty(rows, np.int64), np.empty(rows, np.int64),
        np.zeros((rows, WIDTH)), np.zeros(2, np.int64),
    )  # fmt: skip
    diverged = False
    while flight[0]["t_us"] < end_us and not diverged:
        try:
            _, _, readings = simulation.step()
        except ConfigError:
            break  # it left every envelope before
        record_step(flight, sensors, out)
        for reading in readings:
            if isinstance(reading, GpsReading):
                _append_fix(reading, out)
        if plan.weave is None:
            quiet_us = min(simulation.quiet_until_us(), end_us)
            diverged = not record_steps(flight, sensors, packed, quiet_us, out)
    n, m = out.counts.tolist()
    return SampledFlight(out.truth[:n], Block(out.kind[:m], out.t_us[:m], out.values[:m], {}))


def _append_fix(one: GpsReading, out: FlightRows) -> None:
    m = out.counts[1]
    out.kind[m], out.t_us[m] = FIX, one.t_us
    out.values[m, :11] = (
        one.lat_deg, one.lon_deg, one.alt_m, *one.v_ned_mps, one.fix_type, one.satellites,
        one.eph_m, one.epv_m, GPS_SOURCE,
    )  # fmt: skip
    out.counts[1] += 1


def sampled_flight(document: Mapping[str, Any]) -> SampledFlight:
    """The flight of a scenario, whatever its faults: they do not act on the controls."""
    bare = {key: value for key, value in document.items() if key not in ("schedule", "monitor")}
    return fly_sampled(msgspec.json.encode(bare))


def estimate_attitude(
    truth: Array, samples: Block, name: str, declination_rad: float
) -> tuple[Array, Array]:
    """The attitude (n, 4) of an estimator at the IMU samples, started at the truth, and its errors
    (n, 4): roll, pitch, yaw and the angle [rad]."""
    estimator = make_estimator(name)
    _, q_nb, _ = estimate_block(
        estimator, samples, estimator.start(start_of(truth, samples, declination_rad))
    )
    return q_nb, error_rows(q_nb, truth[:, 6:10])


def start_of(truth: Array, samples: Block, declination_rad: float) -> Prior:
    """The truth at the first sample."""
    r_ned_m, v_b_mps, q_nb = np.split(truth[0, :10], [3, 6])
    velocity = matrix_from_quat(q_nb) @ v_b_mps
    return Prior(int(samples.t_us[0]), q_nb, velocity, r_ned_m, declination_rad)


@compiled
def error_rows(q_nb: Array, truth: Array) -> Array:
    """Errors (n, 4) of attitudes (n, 4), as `attitude_errors` has them; pi where there is NaN."""
    out = np.empty((len(q_nb), 4))
    for i in range(len(q_nb)):
        for k, error in enumerate(attitude_errors(q_nb[i], truth[i])):
            out[i, k] = error if error == error else np.pi
    return out


def dead_reckoning(truth: Array, samples: Block) -> Array:
    """The inverse model's nine states (n, 9) at the IMU samples."""
    estimator = make_estimator("inverse-model")
    state: Any = estimator.start(start_of(truth, samples, 0.0))
    imu = samples.where(samples.kind == IMU)
    nine = np.empty((len(truth), BEFORE - NINE))
    for row in range(len(imu.kind)):
        _, _, state = estimate_block(estimator, imu.between(row, row + 1), state)
        nine[row] = state.x[NINE:BEFORE]
    return nine


def imu_rows(samples: Block) -> Array:
    """Rates and specific force (n, 6) of the IMU samples."""
    return samples.values[samples.kind == IMU, :IMU_ID]
