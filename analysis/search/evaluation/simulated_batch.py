"""Evaluation in the simulator, through the proxy, one flight at a time.

Supports what the compiled kernels lack: any scenario, every fault of the proxy, the sensor fusion,
requirements, and an external autopilot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.scoring.attitude_scores import AXES
from analysis.search.evaluation.evaluator import (
    EvaluationOutcome,
    Evaluator,
    average_draws,
)
from analysis.search.evaluation.point_flight import fly_point
from analysis.search.lanes.noise_kernel import seed_of
from analysis.search.space.airframe import has_rotors, read_airframe, trim_values
from analysis.search.space.dimensions import Space, fault_entries, flight_entries, space_of
from analysis.search.space.point_scenario import Document, document_of
from analysis.search.space.section import Range
from analysis.search.space.test_file import FlightEnvelope, TestFile
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.vehicles.body import Truth

Array = NDArray[np.float64]


class FlightScores(NamedTuple):
    """Scores of one flight: `rmse_deg` and `largest_deg` (4,) as in `EvaluationOutcome`; `parts` as
    `score_breakdown` gives.

    `broken_limit` is the number of the limit that ended it, as in `rows.LIMITS`.
    """

    rmse_deg: Array
    largest_deg: Array
    lasted_s: float
    broken_limit: int
    steps: int
    parts: dict[str, Any]


@dataclass(frozen=True)
class SimulatedBatch(Evaluator):
    """Evaluates a test in the simulator, one flight at a time; `Batch` uses compiled kernels."""

    @cached_property
    def space(self) -> Space:
        """The search space."""
        # The varied numbers of the scenario, by path.
        entries: dict[str, Range] = {f"vary.{name}": ends for name, ends in self.test.vary.items()}
        if self.test.scenario is None:
            # The search's own airframe can fly in the simulator too.
            airframe = read_airframe(self.test.vehicle)
            trim = trim_values(airframe, self.test.density_kgpm3)
            entries = flight_entries(self.test, trim)
        return space_of(entries | fault_entries(self.test))

    def evaluate_values(
        self,
        values: Mapping[str, Array],
        seed: int,
        first: int,
        draws: int,
        same_noise: bool = False,
    ) -> EvaluationOutcome:
        """Fly values as the contract says."""
        # All values have one row per flight.
        count = len(next(iter(values.values())))
        flights = []
        for i in range(count):
            one_flight = {name: float(column[i]) for name, column in values.items()}
            # The seed of a flight comes from its number, as in the compiled kernels.
            number = first if same_noise else first + i
            flights.append(
                [self.scores(one_flight, seed, number * draws + draw) for draw in range(draws)]
            )
        return outcome_of(flights, self.test)

    def scores(self, values: Mapping[str, float], seed: int, number: int) -> FlightScores:
        """Score one flight with noise `number` of `seed`."""
        return score_flight(self.test, document_of(self.test, values, seed_of(seed, number)))


def check_document(document: Document) -> None:
    """Decode a scenario and its faults.

    Raises
    ------
    ConfigError
        If one of the drawn values is not allowed there.
    """
    where = f"the scenario {document.get('name', '')!r}"
    try:
        # Built by the program and not read from a file: errors have no line numbers.
        scenario = msgspec.convert(document, Scenario)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{where}: {error}; narrow its range in vary") from error
    parse_schedule({"seed": scenario.seed, **document["schedule"]}, where)


def score_flight(test: TestFile, document: Document) -> FlightScores:
    """Fly a scenario until its end or until it leaves the envelope, and score the estimator, or how
    far the requirement is violated."""
    check_document(document)
    hovers, broken_limit = test.scenario is None and has_rotors(test.vehicle), 0

    def leaves(truth: Truth) -> bool:
        nonlocal broken_limit
        broken_limit = envelope_violation(truth, test.envelope, hovers)
        return broken_limit > 0

    if test.violate is not None:
        flight = fly_point(test, document)
        (found,) = flight.requirements[test.estimator]
        rmse = largest = np.full(4, -found.fitness)
        parts = {"requirement": msgspec.to_builtins(found), "behaviour": flight.behaviour}
    else:
        flight = fly_point(test, document, stop=leaves)
        parts = flight.attitude.get(test.estimator, {})
        rmse, largest = (
            np.array([parts.get(key, {}).get(axis, 0.0) for axis in AXES])
            for key in ("rmse_deg", "max_deg")
        )
    steps = round(flight.duration_s / test.dt_s)
    return FlightScores(rmse, largest, flight.duration_s, broken_limit, steps, parts)


def envelope_violation(truth: Truth, limits: FlightEnvelope, hovers: bool) -> int:
    """The number of the violated limit (see `rows.LIMITS`), 0 within the envelope.

    If it `hovers`, airspeed and flow angles are not limited.
    """
    u, v, w = truth.v_air_b_mps.tolist()
    # In the plane of symmetry, which contains the angle of attack.
    plane, speed = float(np.hypot(u, w)), float(np.hypot(np.hypot(u, w), v))
    low, high = limits.airspeed_mps
    _, pitch, _ = euler_angles(truth.q_nb.tolist())
    violated = (
        abs(np.degrees(pitch)) > limits.pitch_deg,
        not hovers and abs(np.degrees(np.arctan2(w, u))) > limits.alpha_deg,
        not hovers and np.degrees(np.arctan2(abs(v), plane)) > limits.beta_deg,
        not hovers and not low <= speed <= high,
        np.degrees(np.linalg.norm(truth.omega_b_rps)) > limits.rate_dps,
        np.linalg.norm(truth.specific_force_b_mps2) > limits.load_g * STANDARD_GRAVITY_MPS2,
        truth.height_agl_m <= limits.height_m,
    )
    return next((number for number, is_violated in enumerate(violated, 1) if is_violated), 0)


def outcome_of(flights: Sequence[Sequence[FlightScores]], test: TestFile) -> EvaluationOutcome:
    """The outcome of n evaluations with some draws each."""
    rmse, largest, lasted_s, limit, steps = (
        np.array([[scores[i] for scores in draws] for draws in flights]) for i in range(5)
    )
    worst = rmse[:, :, 3] if test.criterion == "angle" else rmse[:, :, :3].max(axis=2)
    return average_draws(worst, rmse, largest, limit, lasted_s / test.duration_s, int(steps.sum()))
