"""Evaluation of a test's points: fly them, in the simulator or under an autopilot, and score."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.scoring.attitude_scores import AXES
from analysis.search.evaluation.compiled_score import FlightScores, score_compiled
from analysis.search.evaluation.envelope import pack_envelope, violated_limit
from analysis.search.evaluation.point_flight import fly_point
from analysis.search.space.airframe import has_rotors, read_airframe, trim_values
from analysis.search.space.dimensions import Space, fault_entries, flight_entries, space_of
from analysis.search.space.fault_range import Range
from analysis.search.space.point_scenario import Document, document_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.vehicles.body import Truth


class EvaluationOutcome(NamedTuple):
    """The results of n evaluations.

    `fitness` (n,) is the criterion in its unit (`TestFile.unit`), or, where the flight left the
    envelope, minus the share of the time that remained (-1 to 0); `spread_deg` (n,) is its standard
    deviation over the noise draws. `rmse_deg` and `largest_deg` (n, 4): roll, pitch, yaw, angle,
    means over the noise draws. `broken_limit` (n,): indices into `envelope.LIMITS`; `steps` flown
    and scored in total.
    """

    fitness: Array
    spread_deg: Array
    rmse_deg: Array
    largest_deg: Array
    broken_limit: NDArray[np.int64]
    steps: int


@dataclass(frozen=True)
class Evaluator:
    """The same points, seed and numbers give the same outcome (an autopilot's may vary)."""

    test: TestFile

    @cached_property
    def space(self) -> Space:
        """The search space."""
        # The varied numbers of the scenario, by path.
        entries: dict[str, Range] = {f"vary.{name}": ends for name, ends in self.test.vary.items()}
        if self.test.scenario is None:
            airframe = read_airframe(self.test.vehicle)
            trim = trim_values(airframe, self.test.density_kgpm3)
            entries = flight_entries(self.test, trim)
        return space_of(entries | fault_entries(self.test))

    def evaluate(
        self, points: Array, seed: int, first: int, draws: int | None = None
    ) -> EvaluationOutcome:
        """Fly points (n, d) of the unit cube, `draws` times each with their own noise, by seed and
        number; `first` is the number of the first evaluation."""
        draws = self.test.noise_draws if draws is None else draws
        flights = []
        for i, point in enumerate(points):
            values = self.space.values_at(point)
            # By their numbers, splitting the work changes nothing.
            number = (first + i) * draws
            flights += [self.scores(values, seed, number + draw) for draw in range(draws)]
        return average_draws(flights, draws, self.test.duration_s)

    def scores(
        self, values: Mapping[str, float], seed: int, number: int, in_parts: bool = False
    ) -> FlightScores:
        """Score one flight with noise `number` of `seed`; `in_parts` as `FlightScores` says."""
        test, seed = self.test, seed_of(seed, number)
        if test.simulated:
            return score_flight(test, document_of(test, values, seed))
        return score_compiled(test, values, seed, in_parts)


def seed_of(seed: int, number: int) -> int:
    """The simulator's seed of a flight."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1)


def average_draws(flights: list[FlightScores], draws: int, duration_s: float) -> EvaluationOutcome:
    """The outcome of evaluations of some draws each, in order."""
    error, rmse, largest, lasted_s, limit, steps = (
        np.array([getattr(one, name) for one in flights])
        for name in ("error", "rmse_deg", "largest_deg", "lasted_s", "broken_limit", "steps")
    )
    error, lasted = error.reshape(-1, draws), (lasted_s / duration_s).reshape(-1, draws)
    # One limit for all draws: one violation is enough.
    broken = limit.reshape(-1, draws).max(axis=1)
    # From -1 to 0: longer flights score better, which leads a search back into the envelope.
    fitness = np.where(broken > 0, np.minimum(lasted.min(axis=1), 1.0) - 1.0, error.mean(axis=1))
    return EvaluationOutcome(
        # An estimator that diverges to NaN cannot be ranked.
        np.nan_to_num(fitness, nan=-1.0),
        error.std(axis=1),
        rmse.reshape(-1, draws, 4).mean(axis=1),
        largest.reshape(-1, draws, 4).mean(axis=1),
        broken,
        int(steps.sum()),
    )


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
    """Fly a scenario through the proxy until its end or until it leaves the envelope, and score the
    estimator, or how far the requirement is violated."""
    check_document(document)
    hovers, broken_limit = test.scenario is None and has_rotors(test.vehicle), 0
    limits = pack_envelope(test.envelope, hovers)

    def leaves(truth: Truth) -> bool:
        nonlocal broken_limit
        broken_limit = violated_limit(
            truth.q_nb, truth.v_air_b_mps, truth.omega_b_rps, truth.specific_force_b_mps2,
            truth.height_agl_m, limits,
        )  # fmt: skip
        return broken_limit > 0

    parts: dict[str, Any]
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
    error = float(rmse[3] if test.criterion == "angle" else rmse[:3].max())
    return FlightScores(error, rmse, largest, flight.duration_s, broken_limit, steps, parts)
