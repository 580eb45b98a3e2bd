"""Jobs: what one worker does at a time, and the answers that come back."""

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import HEALTHY, MONITOR, Cell, CellResult, Evidence, Flown
from analysis.campaign.flying.internal_flight import fly
from analysis.campaign.outcomes import ABORTED, judged, rank
from analysis.run.setup import Setup, read_setup
from mavproxy_fault.schedule.entries import parse_schedule
from simvehicle.scenario.changed_scenario import parse_change


@dataclass(frozen=True)
class FlightJob:
    """One flight, the answer to cells that differ only in their subject.

    `twin` is the flight without the fault; None if this is the twin. `keep` is the folder for its
    logs, if they are wanted.
    """

    campaign: CampaignFile
    cells: tuple[Cell, ...]
    twin: Flown | None = None
    keep: str | None = None


@dataclass(frozen=True)
class LaneJob:
    """A batch of compiled flights: cells of one subject, scenario, fault and seed."""

    campaign: CampaignFile
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Answer:
    """What became of a job: results of its cells, and what the flight showed."""

    results: list[CellResult]
    flown: Flown | None = None


Job = FlightJob | LaneJob


def answer(job: Job) -> Answer:
    """Fly a job, in whatever process.

    Raises
    ------
    ConfigError
        If the file asks for a flight that cannot be made.
    """
    if isinstance(job, LaneJob):
        # Imported here: whoever flies in the simulator needs none of the search's kernels.
        from analysis.campaign.flying.compiled_lanes import fly_lanes

        return Answer(fly_lanes(job.campaign, job.cells))
    first = job.cells[0]
    onset_s = onset_of(first, job.twin)
    if onset_s is None:
        return failed(job, f"the flight has no {first.onset}")
    flown = flight_of(job, onset_s)
    if job.twin is None:
        return Answer([], flown)
    results = [
        msgspec.structs.replace(
            judged(
                cell,
                onset_s,
                flown.evidence[cell.subject],
                job.twin.evidence.get(cell.subject, Evidence()),
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
    return Answer(results, flown)


def _interesting(results: list[CellResult]) -> bool:
    """Whether a fault did something to a subject."""
    return any(rank(result.outcome) > rank("detected") for result in results)


def failed(job: Job, reason: str) -> Answer:
    """The answer of a job that could not be flown."""
    return Answer([CellResult(cell=cell, outcome=ABORTED, note=reason) for cell in job.cells])


def onset_of(cell: Cell, twin: Flown | None) -> float | None:
    """When the fault sets in; None if the flight never comes to that phase."""
    if not isinstance(cell.onset, str):
        return float(cell.onset)
    # By the twin: the fault may keep the flight itself from ever coming to that phase.
    return None if twin is None else twin.phases.get(cell.onset)


def flight_of(job: FlightJob, onset_s: float) -> Flown:
    """Fly the cells' scenario, with their fault unless this is the twin."""
    cell, campaign = job.cells[0], job.campaign
    entries = []
    if cell.fault != HEALTHY:
        fault = campaign.fault(cell.fault)
        entries.append(fault.entry(cell.magnitude, onset_s, cell.duration_s))
    schedule = {"seed": cell.seed, "faults": entries}
    autopilot = campaign.autopilot(cell.subject)
    if autopilot is not None:
        from analysis.campaign.flying.autopilot_cell import fly_autopilot

        with tempfile.TemporaryDirectory(prefix="campaign-") as scratch:
            folder, kept = Path(job.keep or scratch), job.keep is not None
            run = [*campaign.scenario_words(cell.scenario), *autopilot.options(campaign.folder)]
            return fly_autopilot(autopilot.name, run, schedule, folder, kept=kept)
    subjects = [cell.subject for cell in job.cells]
    setup = setup_of(campaign, cell, subjects)
    faults = parse_schedule(schedule, campaign.name)
    keep = None if job.keep is None else Path(job.keep)
    return fly(setup.scenario, faults, setup.monitor, subjects, keep)


def setup_by_name(campaign: CampaignFile, scenario: str, seed: int | None = None) -> Setup:
    """A scenario by its name in results; errors as `read_setup` has them."""
    file, *changes = campaign.scenario_words(scenario)
    # Every other word is the option's name.
    return read_setup(file, None, seed, dict(map(parse_change, changes[1::2])))


def setup_of(campaign: CampaignFile, cell: Cell, subjects: list[str]) -> Setup:
    """The scenario with the cell's seed and the estimators under test."""
    setup = setup_by_name(campaign, cell.scenario, cell.seed)
    # The monitor runs in any case; it is no estimator of attitude.
    estimators = tuple(name for name in subjects if name != MONITOR)
    attitude = msgspec.structs.replace(setup.monitor.attitude, estimators=estimators)
    monitor = msgspec.structs.replace(setup.monitor, attitude=attitude)
    return replace(setup, monitor=monitor)
