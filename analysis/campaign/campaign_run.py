"""Fly a campaign: reference flights first, then all job sequences; store every answer at once."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from analysis.campaign.campaign_plan import CampaignPlan, JobSequence
from analysis.campaign.cell import CellResult
from analysis.campaign.flying.flight_job import Job, JobAnswer, aborted_answer
from analysis.campaign.results_store import ResultsStore
from analysis.worker_pool import JobFailure, WorkerPool, run_sequences
from mavproxy_fault.documents.errors import ConfigError

ProgressCallback = Callable[[list[CellResult]], None]
RunningJobs = Generator[Job, Any, None]


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
        known, references = self.store.results, self.store.reference_flights
        missing = {k: job for k, job in self.plan.reference_jobs().items() if k not in references}
        run_sequences(self.pool, (self._fly_reference(key, job) for key, job in missing.items()))
        run_sequences(self.pool, map(self._fly_cells, self.plan.job_sequences(known, references)))

    def _fly_reference(self, key: str, job: Job) -> RunningJobs:
        answer = answer_of(job, (yield job))
        if answer.flight is None:
            # Without the reference flight, no outcome can be determined.
            first = answer.results[0]
            raise ConfigError(
                f"{first.cell.scenario}: reference flight of {first.cell.subject} failed: "
                f"{first.note}"
            )
        self.store.add_reference(key, answer.flight)

    def _fly_cells(self, sequence: JobSequence) -> RunningJobs:
        job = next(sequence, None)
        while job is not None:
            answer = answer_of(job, (yield job))
            # Stored before anything else, so that a kill loses nothing.
            self.store.add(answer.results, answer.flight)
            self.progress(answer.results)
            try:
                job = sequence.send(answer.results)
            except StopIteration:
                return


def answer_of(job: Job, answer: JobAnswer | JobFailure) -> JobAnswer:
    """Return a pool's answer of a job; that of a job that failed has aborted cells."""
    return aborted_answer(job, answer.reason) if isinstance(answer, JobFailure) else answer
