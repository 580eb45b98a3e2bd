"""Fly a campaign: reference flights first, then all job sequences; store every answer at once."""

from collections.abc import Callable
from dataclasses import dataclass

from analysis.campaign.campaign_plan import CampaignPlan, JobSequence
from analysis.campaign.cell import CellResult
from analysis.campaign.flying.flight_job import JobAnswer
from analysis.campaign.results_store import ResultsStore
from analysis.campaign.worker_pool import WorkerPool
from analysis.flying.flight_evidence import CampaignFlight
from mavproxy_fault.documents.errors import ConfigError

ProgressCallback = Callable[[list[CellResult]], None]


@dataclass
class CampaignRun:
    """Flies a plan with a worker pool into a results store; `progress` gets each job's results."""

    plan: CampaignPlan
    pool: WorkerPool
    store: ResultsStore
    progress: ProgressCallback

    def run_all(self) -> None:
        """Fly all cells without a stored result.

        Raises
        ------
        ConfigError
            If a reference flight fails.
        """
        self._fly_references()
        sequences = self.plan.job_sequences(self.store.results, self.store.reference_flights)
        running: dict[int, JobSequence] = {}
        count = 0
        while True:
            while (
                len(running) < self.pool.capacity
                and (sequence := next(sequences, None)) is not None
            ):
                count += self._begin(sequence, count, running)
            if not running:
                return
            number, answer = self.pool.finished()
            sequence = running.pop(number)
            # Stored before anything else, so that a kill loses nothing.
            self.store.add(answer.results, answer.flight)
            self.progress(answer.results)
            try:
                job = sequence.send(answer.results)
            # The sequence has ended: its slot is free for another.
            except StopIteration:
                continue
            count += 1
            running[count] = sequence
            self.pool.start(count, job)

    def _begin(self, sequence: JobSequence, count: int, running: dict[int, JobSequence]) -> int:
        """Start the first job of a sequence; return the number started (0 if all are known)."""
        job = next(sequence, None)
        if job is None:
            return 0
        running[count + 1] = sequence
        self.pool.start(count + 1, job)
        return 1

    def _fly_references(self) -> None:
        jobs = {
            k: job
            for k, job in self.plan.reference_jobs().items()
            if k not in self.store.reference_flights
        }
        waiting = list(jobs)
        running: dict[int, str] = {}
        while waiting or running:
            while waiting and len(running) < self.pool.capacity:
                key = waiting.pop(0)
                # Negative, to differ from the numbers of other jobs.
                number = -len(jobs) + len(waiting)
                running[number] = key
                self.pool.start(number, jobs[key])
            number, answer = self.pool.finished()
            self.store.add_reference(running.pop(number), reference_flight_of(answer))


def reference_flight_of(answer: JobAnswer) -> CampaignFlight:
    """Return the flight of a reference job's answer.

    Raises
    ------
    ConfigError
        If the flight failed.
    """
    if answer.flight is None:
        # Without the reference flight, no outcome can be determined.
        first = answer.results[0]
        raise ConfigError(
            f"{first.cell.scenario}: reference flight of {first.cell.subject} failed: {first.note}"
        )
    return answer.flight
