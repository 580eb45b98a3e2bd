"""Jobs: what one worker does at a time, and the answers that come back."""

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import HEALTHY, CampaignFlight, Cell, CellResult, Evidence
from analysis.campaign.flying.internal_flight import run_simulated_flight
from analysis.campaign.outcomes import ABORTED, classify_flight, outcome_rank
from analysis.estimators import estimator_names
from analysis.run.run_setup import RunSetup, read_setup
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.changed_scenario import parse_change


@dataclass(frozen=True)
class FlightJob:
    """One flight, the answer to cells that differ only in their subject.

    `reference` is the flight without the fault; None if this is the twin. `keep` is the folder for
    its logs, if they are wanted.
    """

    campaign: CampaignFile
    cells: tuple[Cell, ...]
    reference: CampaignFlight | None = None
    keep: str | None = None


@dataclass(frozen=True)
class LaneJob:
    """A batch of compiled flights: cells of one subject, scenario, fault and seed."""

    campaign: CampaignFile
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class JobAnswer:
    """What became of a job: results of its cells, and what the flight showed."""

    results: list[CellResult]
    flight: CampaignFlight | None = None


Job = FlightJob | LaneJob


def run_job(job: Job) -> JobAnswer:
    """Fly a job, in whatever process.

    Raises
    ------
    ConfigError
        If the file asks for a flight that cannot be made.
    """
    if isinstance(job, LaneJob):
        # Imported here: whoever flies in the simulator needs none of the search's kernels.
        from analysis.campaign.flying.compiled_lanes import run_lanes

        return JobAnswer(run_lanes(job.campaign, job.cells))
    first = job.cells[0]
    onset_s = onset_time_s(first, job.reference)
    if onset_s is None:
        return aborted_answer(job, f"the flight has no {first.onset}")
    flown = run_cell_flight(job, onset_s)
    if job.reference is None:
        return JobAnswer([], flown)
    results = [
        msgspec.structs.replace(
            classify_flight(
                cell,
                onset_s,
                flown.evidence[cell.subject],
                job.reference.evidence.get(cell.subject, Evidence()),
                job.campaign.limits,
            ),
            verdict=flown.verdict.word,
            blamed=flown.verdict.blamed,
            verdict_s=flown.verdict.delay_s,
            wall_s=flown.wall_s,
        )
        for cell in job.cells
    ]
    # Written and then removed: what a flight was worth is known only in the end.
    if job.keep is not None and job.campaign.keep == "interesting" and not _interesting(results):
        shutil.rmtree(job.keep)
    return JobAnswer(results, flown)


def _interesting(results: list[CellResult]) -> bool:
    """Whether a fault did something to a subject."""
    return any(outcome_rank(result.outcome) > outcome_rank("detected") for result in results)


def aborted_answer(job: Job, reason: str) -> JobAnswer:
    """The answer of a job that could not be flown."""
    return JobAnswer([CellResult(cell=cell, outcome=ABORTED, note=reason) for cell in job.cells])


def onset_time_s(cell: Cell, twin: CampaignFlight | None) -> float | None:
    """When the fault sets in; None if the flight never comes to that phase."""
    if not isinstance(cell.onset, str):
        return float(cell.onset)
    # By the twin: the fault may keep the flight itself from ever coming to that phase.
    return None if twin is None else twin.phases.get(cell.onset)


def run_cell_flight(job: FlightJob, onset_s: float) -> CampaignFlight:
    """Fly the cells' scenario, with their fault unless this is the twin."""
    cell, campaign = job.cells[0], job.campaign
    entries = []
    if cell.fault != HEALTHY:
        fault = campaign.fault(cell.fault)
        entries.append(fault.entry(cell.magnitude, onset_s, cell.duration_s))
    schedule = {"seed": cell.seed, "faults": entries}
    autopilot = campaign.autopilot(cell.subject)
    if autopilot is not None:
        from analysis.campaign.flying.autopilot_cell import run_autopilot_cell

        with tempfile.TemporaryDirectory(prefix="campaign-") as scratch:
            folder, kept = Path(job.keep or scratch), job.keep is not None
            run = [*campaign.scenario_arguments(cell.scenario), *autopilot.options(campaign.folder)]
            return run_autopilot_cell(autopilot.name, run, schedule, folder, kept=kept)
    subjects = [cell.subject for cell in job.cells]
    setup = cell_setup(campaign, cell, subjects)
    faults = parse_schedule(schedule, campaign.name)
    keep = None if job.keep is None else Path(job.keep)
    return run_simulated_flight(setup.scenario, faults, setup.monitor, subjects, keep)


def setup_by_name(campaign: CampaignFile, scenario: str, seed: int | None = None) -> RunSetup:
    """A scenario by its name in results; errors as `read_setup` has them."""
    file, *changes = campaign.scenario_arguments(scenario)
    # Every other word is the option's name.
    return read_setup(file, None, seed, dict(map(parse_change, changes[1::2])))


def cell_setup(campaign: CampaignFile, cell: Cell, subjects: list[str]) -> RunSetup:
    """The scenario with the cell's seed and the estimators under test."""
    setup = setup_by_name(campaign, cell.scenario, cell.seed)
    # The monitor and its detectors run in any case.
    estimators = tuple(name for name in subjects if name in estimator_names())
    attitude = msgspec.structs.replace(setup.monitor.attitude, estimators=estimators)
    monitor = msgspec.structs.replace(setup.monitor, attitude=attitude)
    return replace(setup, monitor=monitor)
