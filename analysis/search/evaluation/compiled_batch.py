"""Evaluation by compiled kernels: fly many points of a test's space and score the estimator."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.estimators import Prior, make_estimator
from analysis.estimators.complementary import Mahony
from analysis.estimators.ekf import Ekf
from analysis.search.evaluation.evaluator import (
    EvaluationOutcome,
    Evaluator,
    average_draws,
)
from analysis.search.evaluation.traced_flight import (
    FlightTrace,
    estimate_attitude,
    trace_flight,
    with_all_sensors,
)
from analysis.search.lanes import rows
from analysis.search.lanes.filter_lanes import EKF, FILTER_SIZE, HEARD, LEVELLED, MAHONY, Tunings
from analysis.search.lanes.inverted_lanes import (
    AIRSPEED,
    HEIGHT,
    PLACES,
    POSITION,
    PRESSURES,
    Place,
)
from analysis.search.lanes.lane_state import Envelope
from analysis.search.lanes.noise_kernel import GENERATORS, streams
from analysis.search.lanes.quad_lanes import QuadModel
from analysis.search.lanes.search_kernel import Plan, fly
from analysis.search.space.airframe import Airframe, hover_rps, read_airframe, trim_values
from analysis.search.space.dimensions import (
    Space,
    fault_entries,
    flight_entries,
    flights_of,
    space_of,
)
from analysis.search.space.point_scenario import FIELD_HZ, GPS_HZ, PRESSURE_HZ, altitude_of
from analysis.search.space.test_file import COMPILED_ESTIMATORS, StateScales, TestFile
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from simvehicle.environment.air import GUST_LEVELS
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.multirotor.sway_kernel import quad_parameters

Array = NDArray[np.float64]
# The number of the kernel without a filter, for flights scored in Python.
HEUN = 0
INVERTED_CRITERIA = {"height": HEIGHT, "airspeed": AIRSPEED, "position": POSITION}
NO_TRACE = np.empty((0, 0))
NO_AERO = Aero(*[0.0] * len(Aero._fields))
KERNELS = dict(zip(COMPILED_ESTIMATORS, (HEUN, MAHONY, MAHONY, EKF), strict=True))


@dataclass(frozen=True)
class Batch(Evaluator):
    """Evaluates a test by compiled kernels; the same points, seed and numbers, the same outcome."""

    @cached_property
    def airframe(self) -> Airframe:
        """The aircraft."""
        return read_airframe(self.test.vehicle)

    @cached_property
    def space(self) -> Space:
        """The search space."""
        trim = trim_values(self.airframe, self.test.density_kgpm3)
        return space_of(flight_entries(self.test, trim) | fault_entries(self.test))

    @cached_property
    def plan(self) -> Plan:
        """The kernel's parameters common to all flights."""
        return plan_of(self.test, self.airframe)

    def evaluate_values(
        self,
        values: Mapping[str, Array],
        seed: int,
        first: int,
        draws: int,
        same_noise: bool = False,
    ) -> EvaluationOutcome:
        """Fly values as the contract says, each draw of each evaluation with its own number."""
        flights = self.columns(values)
        count = flights.shape[1]
        # By their numbers, splitting the work changes nothing.
        numbers = first * draws + np.arange(count * draws).reshape(count, draws)
        if same_noise:
            numbers = np.broadcast_to(numbers[0], numbers.shape)
        columns = self._fly_columns(np.repeat(flights, draws, axis=1), seed, numbers.ravel())
        return outcome_of(columns.reshape(rows.ROWS, count, draws), self.test)

    def columns(self, values: Mapping[str, Array]) -> Array:
        """Values (n,) by name as columns (ROWS, n) for the kernel."""
        return flights_of(self.test, values, hover_rps(self.airframe, self.test.density_kgpm3))

    def _fly_columns(self, flights: Array, seed: int, numbers: NDArray[np.int64]) -> Array:
        """The columns after the kernel's run; `numbers` (n,) select the noise."""
        columns = pad_lanes(flights)
        noise = np.ones((GENERATORS, columns.shape[1]), dtype=np.uint64)
        noise[:, : len(numbers)] = streams(seed, numbers)
        filters = start_filters(self.test.estimator, columns)
        fly(columns, filters, noise, self.plan, NO_TRACE)
        if self.test.estimator not in COMPILED_ESTIMATORS:
            for lane in np.flatnonzero(columns[rows.BROKEN_LIMIT, : len(numbers)] == 0.0):
                # From the initial column: the kernel has overwritten its copy.
                column, number = flights[:, lane], int(numbers[lane])
                # An estimator in Python needs all sensors.
                plan = with_all_sensors(self.plan)
                self._score(
                    columns[:, lane], trace_flight(plan, column, filters[lane], seed, number)
                )
        return columns[:, : len(numbers)]

    def _score(self, column: Array, flight: FlightTrace) -> None:
        """Replace the kernel's scores by those of an estimator in Python."""
        estimate = estimate_attitude(flight, make_estimator(self.test.estimator))
        error = replace(flight, q_estimate=estimate).errors_rad()
        column[rows.SQUARES : rows.SQUARES + 4] = (error**2).sum(axis=0)
        column[rows.LARGEST : rows.LARGEST + 4] = np.abs(error).max(axis=0)


def plan_of(test: TestFile, airframe: Airframe) -> Plan:
    """The kernel's parameters of a test."""
    return Plan(
        steps=round(test.duration_s / test.dt_s),
        dt_s=test.dt_s,
        gravity_mps2=STANDARD_GRAVITY_MPS2,
        density_kgpm3=test.density_kgpm3,
        field_ned_gauss=test.field_ned_gauss,
        declination_rad=float(np.radians(test.declination_deg)),
        field_every=max(1, round(1.0 / FIELD_HZ / test.dt_s)),
        velocity_every=max(1, round(1.0 / GPS_HZ / test.dt_s)),
        pressure_every=max(1, round(1.0 / PRESSURE_HZ / test.dt_s)),
        mission=test.mission is not None,
        gusts=test.gusts != "none",
        gust_sigma_mps=GUST_LEVELS[test.gusts].sigma_mps,
        gust_length_m=GUST_LEVELS[test.gusts].length_m,
        slots=len(test.faults),
        noisy=any(fault.fault == "noise" for fault in test.faults),
        angle=test.criterion == "angle",
        state=test.criterion == "state",
        inverted=test.criterion in INVERTED_CRITERIA,
        place=Place(
            altitude_of(test.density_kgpm3),
            test.density_kgpm3,
            STANDARD_GRAVITY_MPS2,
            test.static_pressure == "linear",
            float(np.exp(-test.position_k_per_s / GPS_HZ)),
        ),
        estimator=KERNELS.get(test.estimator, HEUN),
        tunings=tunings_of(test.estimator),
        sea_density_kgpm3=SEA_LEVEL_DENSITY_KGPM3,
        limits=envelope_of(test),
        body=airframe.body,
        # The kernel has fields for both kinds; those of the other one are unused.
        aero=airframe.aero if isinstance(airframe, FixedWing) else NO_AERO,
        rotors=isinstance(airframe, Multirotor),
        quad=quad_model(airframe if isinstance(airframe, Multirotor) else Multirotor.read("iris")),
    )


def quad_model(quad: Multirotor) -> QuadModel:
    """The kernel's parameters of a quadrotor."""
    first, second, third, fourth = (
        (float(row[0]), float(row[1]), float(row[2]), float(row[3])) for row in quad.rotors
    )
    return QuadModel(quad.frame, (first, second, third, fourth), quad_parameters(quad))


def tunings_of(name: str) -> Tunings:
    """The kernels' filter parameters: the defaults of the estimator of that name."""
    estimator = make_estimator(name)
    mahony = estimator if isinstance(estimator, Mahony) else Mahony()
    ekf = estimator if isinstance(estimator, Ekf) else Ekf()
    return Tunings(mahony.tuning, ekf.tuning)


def envelope_of(test: TestFile) -> Envelope:
    """The limits in the form the kernel compares."""
    limits = test.envelope
    return Envelope(
        # As sine and tangents, so that no lane needs an arc function.
        float(np.sin(np.radians(limits.pitch_deg))),
        float(np.tan(np.radians(limits.alpha_deg))),
        float(np.tan(np.radians(limits.beta_deg))),
        *limits.airspeed_mps,
        float(np.radians(limits.rate_dps)),
        limits.load_g * STANDARD_GRAVITY_MPS2,
        limits.height_m,
    )


def pad_lanes(columns: Array) -> Array:
    """Columns (rows, n) padded to a multiple of LANES with inactive copies of the first."""
    missing = -columns.shape[1] % rows.LANES
    filler = np.repeat(columns[:, :1], missing, axis=1)
    # Inactive from the start; their scores are cut off.
    filler[rows.ALIVE] = 0.0
    return np.ascontiguousarray(np.concatenate([columns, filler], axis=1))


def start_filters(name: str, columns: Array) -> Array:
    """The filters' initial states (n, FILTER_SIZE) at the true attitude and velocity."""
    count = columns.shape[1]
    filters = np.zeros((count, FILTER_SIZE))
    # Without a filter in the kernel any attitude is valid.
    if KERNELS.get(name, HEUN) == HEUN:
        filters[:, 0] = 1.0
        return filters
    estimator = make_estimator(name)
    # Covariance and biases of the estimator's start; attitude and velocity are set below.
    x = estimator.start(Prior(0, np.array([1.0, 0.0, 0.0, 0.0]))).x
    filters[:, : len(x)] = x
    # GPS counts as timed out: gravity is used until the first velocity.
    if isinstance(estimator, Ekf):
        filters[:, HEARD], filters[:, LEVELLED] = -estimator.tuning.gps_timeout_s, 0.0
    q = columns[rows.STATE + 6 : rows.STATE + 10]
    filters[:, :4] = q.T
    if KERNELS[name] == EKF:
        filters[:, 7:10] = ned_velocity(q, columns[rows.STATE + 3 : rows.STATE + 6]).T
    return filters


def ned_velocity(q: Array, v_b_mps: Array) -> Array:
    """Body vectors (3, n) rotated to NED by quaternions (4, n)."""
    turned: Array = np.einsum("nij,jn->in", matrix_from_quat(q.T), v_b_mps)
    return turned


def outcome_of(columns: Array, test: TestFile) -> EvaluationOutcome:
    """Scores from the kernel's rows (ROWS, n, draws)."""
    count = columns[rows.COUNT]
    # A flight may leave the envelope before its first sample is scored.
    safe = np.maximum(count, 1.0)
    rmse = np.degrees(np.sqrt(columns[rows.SQUARES : rows.SQUARES + 4] / safe))
    inverted = inverted_rmse(columns)
    if test.criterion == "state":
        state = columns[rows.STATE_SQUARES : rows.STATE_SQUARES + 12] / safe
        worst = np.sqrt((state / squares_of(test.state_scales)).mean(axis=0))
    elif test.criterion in INVERTED_CRITERIA:
        worst = inverted[INVERTED_CRITERIA[test.criterion]]
    else:
        worst = rmse[3] if test.criterion == "angle" else rmse[:3].max(axis=0)
    return average_draws(
        worst,
        np.moveaxis(rmse, 0, -1),
        np.degrees(np.moveaxis(columns[rows.LARGEST : rows.LARGEST + 4], 0, -1)),
        columns[rows.BROKEN_LIMIT],
        count * test.dt_s / (test.duration_s + test.dt_s),
        int(count.sum()),
        np.moveaxis(inverted, 0, -1),
    )


def inverted_rmse(columns: Array) -> Array:
    """RMSE (3, ...) of height [m], airspeed [m/s] and position [m] from rows (ROWS, ...)."""
    inverted_rows = columns[rows.INVERTED_SQUARES :]
    # Pressures and positions have their own rates; a flight may end before the first.
    counts = np.maximum(inverted_rows[[PRESSURES, PRESSURES, PLACES]], 1.0)
    rmse: Array = np.sqrt(inverted_rows[[HEIGHT, AIRSPEED, POSITION]] / counts)
    return rmse


def squares_of(scales: StateScales) -> Array:
    """The squares of the scales of twelve states (12, 1, 1) in SI units."""
    angle, rate = np.radians([scales.angle_deg, scales.rate_dps])
    each = [scales.position_m, scales.velocity_mps, float(angle), float(rate)]
    return np.repeat(np.square(each), 3)[:, None, None]
