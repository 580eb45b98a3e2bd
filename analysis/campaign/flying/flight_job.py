"""Jobs of the workers, and their answers."""

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import HEALTHY, Cell, CellResult
from analysis.campaign.flying.compiled_cells import run_compiled
from analysis.campaign.outcomes import ABORTED, classify_flight, outcome_rank
from analysis.estimators import estimator_names
from analysis.flying.flight_evidence import CampaignFlight, Evidence
from analysis.flying.internal_flight import run_simulated_flight
from analysis.flying.onset import onset_keys
from analysis.run.run_setup import RunSetup, read_setup
from analysis.scoring.requirements import parse_requirements, requirement_arguments
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.changed_scenario import parse_change


@dataclass(frozen=True)
class FlightJob:
    """One flight, for cells that differ only in their subject, or a batch of compiled flights
    of cells that share subject, scenario, fault and seed.

    `reference` is the fault-free reference flight, None if this is the reference; `keep` is the
    folder for the logs, None to discard them.
    """

    campaign: CampaignFile
    cells: tuple[Cell, ...]
    reference: CampaignFlight | None = None
    keep: str | None = None

    def run(self) -> "JobAnswer":
        """Fly the job in this process.

        Raises
        ------
        ConfigError
            If the flight fails because of the campaign file.
        """
        if self.campaign.compiled:
            return JobAnswer(run_compiled(self.campaign, self.cells))
        first = self.cells[0]
        start = onset_keys(first.onset)
        # The phase of the reference flight, since the fault may keep its own from reaching it.
        if not start and self.reference is not None:
            if first.onset not in self.reference.phases:
                return aborted_answer(self, f"the flight has no {first.onset}")
            start = {"at_s": self.reference.phases[str(first.onset)]}
        flight = run_cell_flight(self, start)
        if self.reference is None:
            return JobAnswer([], flight)
        # A condition is met when the flight does so.
        onset_s = start["at_s"] if len(start) == 1 else flight.fault_s
        if onset_s is None:
            return aborted_answer(self, f"no fault acted: {first.onset} did not come")
        results = [self._judge(cell, onset_s, flight, self.reference) for cell in self.cells]
        # Logs are removed afterwards, once the outcome is known.
        unneeded = self.campaign.keep == "interesting" and not _interesting(results)
        if self.keep is not None and unneeded:
            shutil.rmtree(self.keep)
        return JobAnswer(results, flight)

    def _judge(
        self, cell: Cell, onset_s: float, flight: CampaignFlight, reference: CampaignFlight
    ) -> CellResult:
        own, healthy = flight.evidence[cell.subject], reference.evidence.get(cell.subject)
        return msgspec.structs.replace(
            classify_flight(cell, onset_s, own, healthy or Evidence(), self.campaign.limits),
            verdict=flight.verdict.word,
            blamed=flight.verdict.blamed,
            verdict_s=flight.verdict.delay_s,
            failed=flight.failed,
            wall_s=flight.wall_s,
            requirements=flight.requirements.get(cell.subject, []),
        )


@dataclass(frozen=True)
class JobAnswer:
    """The results of a job's cells, and the flight with its evidence."""

    results: list[CellResult]
    flight: CampaignFlight | None = None


def _interesting(results: list[CellResult]) -> bool:
    """Whether an outcome is worse than detected."""
    return any(outcome_rank(result.outcome) > outcome_rank("detected") for result in results)


def aborted_answer(job: FlightJob, reason: str) -> JobAnswer:
    """Build the answer of a job whose flight failed."""
    return JobAnswer([CellResult(cell=cell, outcome=ABORTED, note=reason) for cell in job.cells])


def run_cell_flight(job: FlightJob, start: dict[str, Any]) -> CampaignFlight:
    """Fly the cells' scenario, with their fault unless this is the reference flight."""
    cell, campaign = job.cells[0], job.campaign
    entries: list[dict[str, Any]] = []
    if cell.fault != HEALTHY:
        fault = campaign.all_faults[cell.fault]
        entries = fault.entries(cell.magnitude, start, cell.duration_s)
    schedule = {"seed": cell.seed, "faults": entries}
    autopilot = campaign.autopilot(cell.subject)
    if autopilot is not None:
        from analysis.flying.autopilot_cell import run_autopilot_cell

        with tempfile.TemporaryDirectory(prefix="campaign-") as scratch:
            folder, kept = Path(job.keep or scratch), job.keep is not None
            run = [*campaign.scenario_arguments(cell.scenario), *autopilot.options(campaign.folder)]
            run += requirement_arguments(parse_requirements(campaign.requirements))
            return run_autopilot_cell(
                autopilot.name, run, schedule, folder, campaign.criteria, kept=kept
            )
    subjects = [cell.subject for cell in job.cells]
    setup = setup_by_name(campaign, cell.scenario, cell.seed, subjects)
    faults = parse_schedule(schedule, campaign.name)
    keep = None if job.keep is None else Path(job.keep)
    setup = replace(setup, schedule=faults)
    return run_simulated_flight(setup, subjects, keep)


def setup_by_name(
    campaign: CampaignFile, scenario: str, seed: int | None = None, subjects: Sequence[str] = (),
    flown: bool = True,
) -> RunSetup:  # fmt: skip
    """Read a scenario by its name in results, with the estimators among the subjects; errors as in
    `read_setup`."""
    file, *changes = campaign.scenario_arguments(scenario)
    # The monitor and its detectors run in any case.
    estimators = [name for name in subjects if name in estimator_names()]
    # Every other argument is the option's name.
    required = requirement_arguments(parse_requirements(campaign.requirements))[1::2]
    changed = dict(map(parse_change, changes[1::2]))
    return read_setup(file, None, seed, changed, estimators, required, flown)
