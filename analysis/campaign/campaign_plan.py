"""The plan of a campaign: its cells as sequences of jobs.

A sequence yields its next job once the results of the last one are stored; a grid cell has one job,
a bisection several. Cells with stored results are not flown again.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import groupby, product
from pathlib import Path
from random import Random

import msgspec

from analysis.campaign.bisection import HALVINGS, CriticalMagnitude, bisect_magnitude
from analysis.campaign.campaign_file import CampaignFile, SubjectChoice
from analysis.campaign.cell import HEALTHY, Cell, CellResult, file_key
from analysis.campaign.flying.flight_job import FlightJob, setup_by_name
from analysis.campaign.outcomes import ABORTED
from analysis.flying.flight_evidence import CampaignFlight
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra

MAX_BATCH_CELLS = 256  # cells in one batch, so that progress shows and a kill loses little
KnownResults = Mapping[str, CellResult]
SizedSeries = tuple[Cell, float | None]
JobSequence = Iterator[FlightJob]


class CampaignPlan:
    """The cells and jobs of a campaign; `keep` is the folder for logs, None to discard them.

    With a `sample` only as many cells of each subject are flown, the same in every run.
    """

    def __init__(
        self, campaign: CampaignFile, keep: Path | None = None, sample: int | None = None
    ) -> None:
        self.campaign = campaign
        self._keep, self._sample = keep, sample
        if sample is not None and campaign.find == "critical":
            raise ConfigError("--sample: a search for critical magnitudes has no cells to draw")
        self.subjects = campaign.subject_names
        self.scenarios = campaign.scenario_names

    # -- size ------------------------------------------------------------------------------------

    @property
    def max_cells(self) -> int:
        """The number of cells; the largest possible one for a critical search."""
        faults, critical = self.campaign.all_faults, self.campaign.find == "critical"
        if self._sample is not None:
            return sum(len(cells) for cells in self._grid())
        return sum(
            HALVINGS + 2 if critical else len(faults[cell.fault].magnitude_list())
            for cell in self._series()
        )

    @property
    def max_flights(self) -> int:
        """The number of flights, without the reference flights."""
        # A shared flight serves all its subjects.
        return self.max_cells // len(self.subjects) * len(self._groups())

    @property
    def flight_s(self) -> float:
        """The mean duration of a flight in simulated seconds."""
        if self.campaign.compiled:
            lengths = [s.compiled.get("duration_s", 60.0) for s in self.campaign.scenarios]  # type: ignore[union-attr]
        else:
            setups = (setup_by_name(self.campaign, name, flown=False) for name in self.scenarios)
            lengths = [setup.scenario.duration_s for setup in setups]
        return float(sum(lengths) / len(lengths))

    def _groups(self) -> list[list[str]]:
        """Group the subjects by flight: those flown by the simulator's controller share one."""
        if self.campaign.find == "critical" or self.campaign.compiled:
            return [[name] for name in self.subjects]
        groups: list[list[str]] = []
        onboard: list[str] = []
        for name, subject in zip(self.subjects, self.campaign.subjects, strict=True):
            if isinstance(subject, SubjectChoice):
                groups.append([name])
            else:
                onboard.append(name)
        return [onboard, *groups] if onboard else groups

    # -- reference flights -----------------------------------------------------------------------

    def reference_jobs(self) -> dict[str, FlightJob]:
        """Return the jobs of the reference flights, by key."""
        if self.campaign.compiled:
            # Each compiled batch contains its reference flight.
            return {}
        jobs = {}
        for group, scenario, seed in product(self._groups(), self.scenarios, self.campaign.seeds):
            cells = tuple(
                Cell(subject=name, scenario=scenario, fault=HEALTHY, seed=seed) for name in group
            )
            jobs[self.reference_key(cells[0])] = FlightJob(
                self.campaign, cells, None, self._folder(cells[0])
            )
        if self._sample is not None:
            needed = {self.reference_key(cells[0]) for cells in self._grid()}
            jobs = {key: job for key, job in jobs.items() if key in needed}
        return jobs

    def reference_key(self, cell: Cell) -> str:
        """Return the key of a cell's reference flight; subjects that share flights share it."""
        # The first subject represents all that share the flight.
        first = next(group[0] for group in self._groups() if cell.subject in group)
        return f"{first}|{cell.scenario}|{cell.seed}"

    def _folder(self, cell: Cell) -> str | None:
        """Return the folder for the logs of a flight."""
        return None if self._keep is None else str(self._keep / file_key(*cell.key.split("|")))

    # -- cells -----------------------------------------------------------------------------------

    def job_sequences(
        self, known: KnownResults, references: Mapping[str, CampaignFlight]
    ) -> Iterator[JobSequence]:
        """Yield the job sequences of cells without a stored result; `known` grows with answers."""
        if self.campaign.find == "critical":
            for cell in self._series():
                yield self._critical(cell, known, references)
        elif self.campaign.compiled:
            yield from self._compiled(known)
        else:
            for cells in self._grid():
                missing = tuple(cell for cell in cells if cell.key not in known)
                if missing:
                    yield iter([self._job(missing, references)])

    @cached_property
    def _covering(self) -> frozenset[tuple[object, ...]]:
        """The conditions of pairs in a covering array: each two values of the lists, one being a
        fault with its magnitude, occur together."""
        campaign = self.campaign
        pairs = {
            tuple(part.name + str(part.magnitudes) for part in pair.faults): pair.name
            for pair in campaign.pairs
        }
        rows = import_extra("allpairspy").AllPairs(
            [
                [one for one, _ in pairs], [other for _, other in pairs], self.scenarios,
                campaign.onsets, campaign.durations_s, campaign.seeds,
            ],
            filter_func=lambda row: len(row) < 2 or tuple(row[:2]) in pairs,
        )  # fmt: skip
        return frozenset((pairs[tuple(row[:2])], *row[2:]) for row in rows)

    def _series(self) -> Iterator[Cell]:
        """Yield one cell of each series, without a magnitude."""
        campaign = self.campaign
        for subject, scenario, fault, onset, duration_s, seed in product(
            self.subjects, self.scenarios, campaign.all_faults, campaign.onsets,
            campaign.durations_s, campaign.seeds,
        ):  # fmt: skip
            # Of pairs under a covering array, only those in it are flown.
            covered = campaign.cover != "all" and fault in campaign.pair_names
            if not covered or (fault, scenario, onset, duration_s, seed) in self._covering:
                yield Cell(
                    subject=subject, scenario=scenario, fault=fault, onset=onset,
                    duration_s=duration_s, seed=seed,
                )  # fmt: skip

    def _grid(self) -> Iterator[list[Cell]]:
        """Yield the cells of each flight."""
        faults = self.campaign.all_faults
        for group in self._groups():
            flights = (
                (series, magnitude)
                for series in self._series()
                if series.subject == group[0]
                for magnitude in faults[series.fault].magnitude_list()
            )
            for series, magnitude in self._drawn(flights):
                yield [cell_at(series, magnitude, subject) for subject in group]

    def _drawn(self, flights: Iterator[SizedSeries]) -> Iterable[SizedSeries]:
        """Draw the sample, the same for all subjects; the first flights of one are a sample too."""
        if self._sample is None:
            return flights
        listed = list(flights)
        count = min(self._sample, len(listed))
        return (listed[i] for i in Random(1).sample(range(len(listed)), count))

    def _compiled(self, known: KnownResults) -> Iterator[JobSequence]:
        """Yield compiled batches of cells that differ in magnitude, onset and duration."""
        cells = (cell for group in self._grid() for cell in group if cell.key not in known)
        # `groupby` needs sorted input.
        ordered = sorted(cells, key=_batch_key)
        for _, batch in groupby(ordered, key=_batch_key):
            listed = tuple(batch)
            for start in range(0, len(listed), MAX_BATCH_CELLS):
                yield iter([self._job(listed[start : start + MAX_BATCH_CELLS], {})])

    def _job(self, cells: tuple[Cell, ...], references: Mapping[str, CampaignFlight]) -> FlightJob:
        # A compiled batch contains its reference flight.
        compiled = self.campaign.compiled
        reference = None if compiled else references[self.reference_key(cells[0])]
        return FlightJob(self.campaign, cells, reference, self._folder(cells[0]))

    def _bisect(self, series: Cell, known: KnownResults) -> Cell | CriticalMagnitude | None:
        """Bisect one series by the stored results: return the critical magnitude, or the next cell
        to fly; None after an aborted flight."""
        search = bisect_magnitude(self.campaign.all_faults[series.fault].interval())
        magnitude = next(search)
        while True:
            cell = cell_at(series, magnitude, series.subject)
            result = known.get(cell.key)
            if result is None:
                return cell
            if result.outcome == ABORTED:
                # Without an outcome the bisection cannot choose a half.
                return None
            try:
                magnitude = search.send(self.campaign.limits.is_worse(result.outcome))
            except StopIteration as over:
                return over.value  # type: ignore[no-any-return]

    def _critical(
        self, series: Cell, known: KnownResults, references: Mapping[str, CampaignFlight]
    ) -> JobSequence:
        """Yield the flights of the bisection of one series."""
        while isinstance(cell := self._bisect(series, known), Cell):
            yield self._job((cell,), references)

    def critical_magnitudes(self, known: KnownResults) -> dict[tuple[str, ...], CriticalMagnitude]:
        """Return the results of the completed bisections, by series."""
        found = {series.series: self._bisect(series, known) for series in self._series()}
        return {key: one for key, one in found.items() if isinstance(one, CriticalMagnitude)}


def cell_at(series: Cell, magnitude: float | None, subject: str) -> Cell:
    """Return the cell of a series with this magnitude and subject."""
    return msgspec.structs.replace(series, magnitude=magnitude, subject=subject)


def _batch_key(cell: Cell) -> tuple[str, str, str, int]:
    return cell.subject, cell.scenario, cell.fault, cell.seed
