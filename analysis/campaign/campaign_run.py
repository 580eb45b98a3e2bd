"""A campaign as it is flown: twins first, then every thread of jobs, each answer kept at once."""

from collections.abc import Callable
from dataclasses import dataclass

from analysis.campaign.campaign_plan import CampaignPlan, JobSequence
from analysis.campaign.cell import CampaignFlight, CellResult
from analysis.campaign.flying.flight_job import JobAnswer
from analysis.campaign.results_store import ResultsStore
from analysis.campaign.worker_pool import WorkerPool
from mavproxy_fault.documents.errors import ConfigError

ProgressCallback = Callable[[list[CellResult]], None]


@dataclass
class CampaignRun:
    """Flies a plan with a fleet into a ledger; `progress` is shown each job's results."""

    plan: CampaignPlan
    pool: WorkerPool
    store: ResultsStore
    progress: ProgressCallback

    def run_all(self) -> None:
        """Fly all that the ledger does not know yet.

        Raises
        ------
        ConfigError
            If a twin cannot be flown: then nothing of the campaign can.
        """
        self._fly_references()
        todo = self.plan.job_sequences(self.store.results, self.store.reference_flights)
        in_air: dict[int, JobSequence] = {}
        count = 0
        while True:
            while len(in_air) < self.pool.capacity and (thread := next(todo, None)) is not None:
                count += self._begin(thread, count, in_air)
            if not in_air:
                return
            number, answer = self.pool.finished()
            thread = in_air.pop(number)
            # Kept before anything else: a kill after this loses nothing.
            self.store.add(answer.results, answer.flight)
            self.progress(answer.results)
            try:
                job = thread.send(answer.results)
            # The thread has its answer: its place is free for another.
            except StopIteration:
                continue
            count += 1
            in_air[count] = thread
            self.pool.start(count, job)

    def _begin(self, thread: JobSequence, count: int, in_air: dict[int, JobSequence]) -> int:
        """Start a thread's first job; how many were started (0 if all of it is known)."""
        job = next(thread, None)
        if job is None:
            return 0
        in_air[count + 1] = thread
        self.pool.start(count + 1, job)
        return 1

    def _fly_references(self) -> None:
        jobs = {
            k: job
            for k, job in self.plan.reference_jobs().items()
            if k not in self.store.reference_flights
        }
        waiting = list(jobs)
        in_air: dict[int, str] = {}
        while waiting or in_air:
            while waiting and len(in_air) < self.pool.capacity:
                key = waiting.pop(0)
                # Negative, so that they cannot be mistaken for numbers of jobs.
                number = -len(jobs) + len(waiting)
                in_air[number] = key
                self.pool.start(number, jobs[key])
            number, answer = self.pool.finished()
            self.store.add_reference(in_air.pop(number), reference_flight_of(answer))


def reference_flight_of(answer: JobAnswer) -> CampaignFlight:
    """The flight of an answer to a twin's job.

    Raises
    ------
    ConfigError
        If there was none.
    """
    if answer.flight is None:
        # Without its twin nothing can be judged.
        first = answer.results[0]
        raise ConfigError(
            f"{first.cell.scenario}: {first.cell.subject} cannot be flown without a fault: "
            f"{first.note}"
        )
    return answer.flight
