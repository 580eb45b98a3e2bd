"""Score an estimator on a compiled flight with faults: attitude, states, inverted sensors."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import asdict

from analysis.estimators import Prior, estimate_block, make_estimator
from analysis.estimators.inverse_model import InverseModel
from analysis.samples.block import AIRSPEED, BARO, FIX, IMU, IMU_ID, Block, Stamps
from analysis.scoring.attitude_scores import ErrorBins, flight_phases, score_breakdown
from analysis.search.evaluation.compiled_flight import (
    AIR,
    FORCE,
    PLACE,
    SampledFlight,
    error_rows,
    nine_states,
    sampled_flight,
)
from analysis.search.space.point_scenario import document_of, faults_of
from analysis.search.space.sample_faults import break_samples
from analysis.search.space.test_file import TestFile
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.earth import curvature_radii
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat, matrix_from_quat
from mavproxy_fault.wire.label import Label
from simvehicle.environment.air import pressure_altitude

BIN_US = 100_000
STATES = (
    "north_m", "east_m", "down_m", "u_mps", "v_mps", "w_mps", "roll_deg", "pitch_deg", "yaw_deg",
    "p_dps", "q_dps", "r_dps",
)  # fmt: skip


class FlightScores(NamedTuple):
    """Scores of one flight: `error` is the criterion in its unit, `rmse_deg` and `largest_deg` (4,)
    are those of `AXES`; `broken_limit` is the index into `envelope.LIMITS` of what ended it.

    `parts`, where they were asked for: as `score_breakdown` gives them, for the inverse model also
    the RMSE of twelve states and of the inverted sensor models.
    """

    error: float
    rmse_deg: Array
    largest_deg: Array
    lasted_s: float
    broken_limit: int
    steps: int
    parts: dict[str, Any]


class EstimatedFlight(NamedTuple):
    """A compiled flight, as far as it is within the envelope, with an estimator's attitude.

    Stamps `t_us` (n,) and `truth` (n, TRUTH_SIZE) at the IMU samples; `q_nb` (n, 4) and `error_rad`
    (n, 4) of the estimate; all `samples`, with faults; the `limit` that ended it; its `prior`.
    """

    t_us: Stamps
    truth: Array
    q_nb: Array
    error_rad: Array
    samples: Block
    limit: int
    prior: Prior

    @property
    def t_s(self) -> Array:
        """Times (n,) since the start."""
        return np.asarray(self.t_us * 1e-6)

    @property
    def imu(self) -> Array:
        """Rates and specific force (n, 6) of the IMU samples."""
        return self.samples.values[self.samples.kind == IMU, :IMU_ID]


def fly_estimated(test: TestFile, values: Mapping[str, float], seed: int) -> EstimatedFlight:
    """Fly the values of a compiled test; `seed` is the simulator's."""
    return estimate_flight(
        test, sampled_flight(test, document_of(test, values, seed)), values, seed
    )


def estimate_flight(
    test: TestFile, flight: SampledFlight, values: Mapping[str, float], seed: int
) -> EstimatedFlight:
    """Run the estimator on the samples of a flight with the faults of these values."""
    truth, samples, limit, prior = flight
    t_us = samples.t_us[samples.kind == IMU]
    broken = break_samples(samples, faults_of(test, values), seed)
    estimator = make_estimator(test.estimator)
    # It starts at the truth.
    start = replace(prior, declination_rad=float(np.radians(test.declination_deg)))
    _, q_nb, _ = estimate_block(estimator, broken, estimator.start(start))
    error_rad = error_rows(q_nb, truth[:, 6:10])
    return EstimatedFlight(t_us, truth, q_nb, error_rad, broken, limit, prior)


def score_compiled(
    test: TestFile, values: Mapping[str, float], seed: int, in_parts: bool = False
) -> FlightScores:
    """Fly the values of a compiled test and score them."""
    flight = fly_estimated(test, values, seed)
    scores = score_estimated(test, flight)
    if not in_parts:
        return scores
    parts = score_breakdown(error_bins(flight), fault_labels(test, values), BIN_US)
    if test.estimator == "inverse-model":
        parts["state_rmse"] = dict(zip(STATES, state_rmse(flight).tolist(), strict=True))
        parts["inverted_rmse"] = inverted_rmse(flight, test.density_kgpm3)
    return scores._replace(parts=parts)


def score_estimated(test: TestFile, flight: EstimatedFlight) -> FlightScores:
    """Score a flight by the criterion of its test."""
    rmse = np.degrees(np.sqrt((flight.error_rad**2).mean(axis=0)))
    largest = np.degrees(np.abs(flight.error_rad).max(axis=0))
    if test.criterion == "state":
        # Its fields are in the order of STATES, three axes each.
        scales = np.repeat(list(asdict(test.state_scales).values()), 3)
        error = float(np.sqrt(((state_rmse(flight) / scales) ** 2).mean()))
    elif test.criterion in ("euler", "angle"):
        error = float(rmse[3] if test.criterion == "angle" else rmse[:3].max())
    else:
        error = inverted_rmse(flight, test.density_kgpm3)[INVERTED[test.criterion]]
    lasted_s = float(flight.t_s[-1]) if flight.limit else test.duration_s
    return FlightScores(error, rmse, largest, lasted_s, flight.limit, len(flight.t_s), {})


def fault_labels(test: TestFile, values: Mapping[str, float]) -> list[Label]:
    """The intervals of the faults, as the proxy labels them."""
    return [
        Label(
            id=fault["id"], fault=fault["fault"], t0_us=0, start_us=round(fault["at_s"] * 1e6),
            end_us=round((fault["at_s"] + fault["for_s"]) * 1e6) if "for_s" in fault else None,
        )
        for fault in faults_of(test, values)
    ]  # fmt: skip


def error_bins(flight: EstimatedFlight) -> ErrorBins:
    """The errors of a flight in time bins of BIN_US."""
    t_us = flight.t_us - flight.t_us[0]
    begins = np.flatnonzero(np.diff(t_us // BIN_US, prepend=-1))
    q_nb, v_b_mps = flight.truth[begins, 6:10], flight.truth[begins, 3:6]
    v_ned_mps = np.einsum("nij,nj->ni", matrix_from_quat(q_nb), v_b_mps)
    sums = [
        np.diff(begins, append=len(t_us)),
        np.add.reduceat(flight.error_rad**2, begins),
        np.maximum.reduceat(np.abs(flight.error_rad), begins),
    ]
    phases = flight_phases(q_nb, v_ned_mps)
    return ErrorBins(t_us[begins], phases, np.column_stack(sums), flight.error_rad[begins])


def state_rmse(flight: EstimatedFlight) -> Array:
    """RMSE (12,) of the inverse model in the units of STATES; its rates are the gyro's."""
    imu, truth = flight.samples.where(flight.samples.kind == IMU), flight.truth
    nine = nine_states(imu.kind, imu.t_us, imu.values, InverseModel().start(flight.prior))
    angle = nine[:, :3] - euler_from_quat(truth[:, 6:10])
    error = np.column_stack(
        [
            nine[:, 6:9] - truth[:, :3],
            nine[:, 3:6] - truth[:, 3:6],
            # Wrapped, since 179 and -179 degrees differ by 2, not 358.
            np.degrees((angle + np.pi) % (2.0 * np.pi) - np.pi),
            np.degrees(flight.imu[:, :3] - truth[:, 10:13]),
        ]
    )
    return np.asarray(np.sqrt((error**2).mean(axis=0)))


INVERTED = {"height": "height_m", "airspeed": "airspeed_mps", "position": "position_m"}


def inverted_rmse(flight: EstimatedFlight, density_kgpm3: float) -> dict[str, float]:
    """RMSE of height from pressure, airspeed from the pitot tube and position from GPS, as the
    inverted models of these sensors give them; of the airspeed only with a pitot tube."""
    found = {}
    for kind, name in ((BARO, "height_m"), (AIRSPEED, "airspeed_mps"), (FIX, "position_m")):
        rows = flight.samples.kind == kind
        values = flight.samples.values[rows]
        truth = flight.truth[np.searchsorted(flight.t_us, flight.samples.t_us[rows])]
        lat, _, alt_m = truth[:, PLACE:].T
        if kind == BARO:
            pressures_pa = np.maximum(values[:, 0], 1.0).tolist()
            off = np.array([pressure_altitude(one) for one in pressures_pa]) - alt_m
        elif kind == AIRSPEED:
            speed_mps = np.sqrt(2.0 * np.maximum(values[:, 0], 0.0) / density_kgpm3)
            off = speed_mps - np.linalg.norm(truth[:, AIR:FORCE], axis=1)
        else:
            meridian_m, prime_m = curvature_radii(lat)
            north, east = (np.radians(values[:, :2]) - truth[:, PLACE : PLACE + 2]).T
            axes = (north * (meridian_m + alt_m), east * (prime_m + alt_m) * np.cos(lat),
                    values[:, 2] - alt_m)  # fmt: skip
            off = np.linalg.norm(axes, axis=0)
        if len(off) or kind != AIRSPEED:
            found[name] = float(np.sqrt((off**2).mean())) if len(off) else 0.0
    return found
