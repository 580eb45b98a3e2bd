"""One case in detail: errors by flight phase and by fault, percentiles, all twelve states."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.estimators import make_estimator
from analysis.scoring.attitude_scores import ErrorBins, flight_phases, score_breakdown
from analysis.search.evaluation.compiled_batch import (
    Batch,
    ned_velocity,
    start_filters,
)
from analysis.search.evaluation.traced_flight import (
    FlightTrace,
    estimate_attitude,
    trace_flight,
    with_all_sensors,
)
from analysis.search.shrink import pin_values
from analysis.search.space.test_file import COMPILED_ESTIMATORS, TestFile
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat
from mavproxy_fault.wire.label import Label

INVERTED_STATES = ("height_m", "airspeed_mps", "position_m")
Array = NDArray[np.float64]
BIN_US = 100_000
STATES = (
    "north_m", "east_m", "down_m", "u_mps", "v_mps", "w_mps", "roll_deg", "pitch_deg", "yaw_deg",
    "p_dps", "q_dps", "r_dps",
)  # fmt: skip


def case_breakdown(
    test: TestFile, values: Mapping[str, float], seed: int, number: int
) -> dict[str, Any]:
    """Scores as `score_breakdown` gives them, and for the inverse model those of all twelve states
    and of the inverted sensor models.

    `seed` and `number` select the noise.
    """
    if test.simulated:
        from analysis.search.evaluation.simulated_batch import SimulatedBatch

        return SimulatedBatch(test).scores(values, seed, number).parts
    flight = trace_case(test, values, seed, number)
    error = flight.errors_rad()
    labels = [
        Label(
            id=f"drawn-{i}", fault=f.fault, t0_us=0, start_us=round(f.at_s * 1e6),
            end_us=None if f.for_s is None else round((f.at_s + f.for_s) * 1e6),
        )
        for i, f in enumerate(pin_values(test, values).faults)
        # A fault drawn over a range has no single interval to score.
        if isinstance(f.at_s, float) and not isinstance(f.for_s, tuple)
    ]  # fmt: skip
    parts = score_breakdown(error_bins(flight, error), labels, BIN_US)
    if test.estimator == "inverse-model":
        parts["state_rmse"] = dict(zip(STATES, state_rmse(flight).tolist(), strict=True))
        inverted = Batch(msgspec.structs.replace(test, criterion="height"))
        columns = {name: np.array([value]) for name, value in values.items()}
        errors = inverted.evaluate_values(columns, seed, number, 1).inverted_rmse[0].tolist()
        named = dict(zip(INVERTED_STATES, errors, strict=True))
        if flight.plan.rotors:
            del named["airspeed_mps"]  # without a pitot tube
        parts["inverted_rmse"] = named
    return parts


def trace_case(test: TestFile, values: Mapping[str, float], seed: int, number: int) -> FlightTrace:
    """The traced flight, with the attitude of the estimator under test."""
    batch = Batch(test)
    column = batch.columns({name: np.array([value]) for name, value in values.items()})
    filters = start_filters(test.estimator, column)[0]
    # Compiled estimators run during the flight; others on its recorded sensors afterwards.
    if test.estimator in COMPILED_ESTIMATORS:
        return trace_flight(batch.plan, column[:, 0], filters, seed, number)
    flight = trace_flight(with_all_sensors(batch.plan), column[:, 0], filters, seed, number)
    return replace(flight, q_estimate=estimate_attitude(flight, make_estimator(test.estimator)))


def error_bins(flight: FlightTrace, error: Array) -> ErrorBins:
    """Errors (n, 4) of a flight in time bins of BIN_US."""
    # Complete steps of the flight per bin, at least one.
    length = max(1, round(BIN_US * 1e-6 / flight.plan.dt_s))
    begins = np.arange(0, len(error), length)
    velocity = ned_velocity(flight.state[:, 6:10].T, flight.state[:, 3:6].T).T
    counts = np.diff(begins, append=len(error))
    squares = np.add.reduceat(error**2, begins)
    largest = np.maximum.reduceat(np.abs(error), begins)
    return ErrorBins(
        np.rint(begins * flight.plan.dt_s * 1e6).astype(np.int64),
        flight_phases(flight.state[begins, 6:10], velocity[begins]),
        np.column_stack([counts, squares, largest]),
        error[begins],
    )


def state_rmse(flight: FlightTrace) -> Array:
    """RMSE (12,) in the units of STATES; the estimated rates are the gyro's."""
    angle = flight.estimate[:, 0:3] - euler_from_quat(flight.state[:, 6:10])
    error = np.column_stack(
        [
            flight.estimate[:, 6:9] - flight.state[:, 0:3],
            flight.estimate[:, 3:6] - flight.state[:, 3:6],
            # Wrapped, since 179 and -179 degrees differ by 2, not 358.
            np.degrees((angle + np.pi) % (2.0 * np.pi) - np.pi),
            np.degrees(flight.measured[:, 0:3] - flight.state[:, 10:13]),
        ]
    )
    return np.asarray(np.sqrt((error**2).mean(axis=0)))
