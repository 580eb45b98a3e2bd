"""Fly a campaign: reference flights first, then all job sequences; store every answer at once."""

import argparse
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.campaign.campaign_plan import CampaignPlan, JobSequence
from analysis.campaign.cell import CellResult
from analysis.campaign.flying.flight_job import FlightJob, JobAnswer, aborted_answer
from analysis.campaign.outcomes import outcome_rank
from analysis.campaign.results.campaign_report import write_report
from analysis.campaign.results.live_heat_map import LiveHeatMap
from analysis.campaign.results.outcome_table import print_outcomes
from analysis.campaign.results_store import ResultsStore
from analysis.flying.worker_pool import JobFailure, WorkerPool, open_worker_pool, run_sequences
from analysis.work_progress import WorkProgress
from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError

ProgressCallback = Callable[[list[CellResult]], None]
RunningJobs = Generator[FlightJob, Any, None]


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

    def _fly_reference(self, key: str, job: FlightJob) -> RunningJobs:
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
        for job in sequence:
            answer = answer_of(job, (yield job))
            # Stored before anything else, so that a kill loses nothing.
            self.store.add(answer.results, answer.flight)
            self.progress(answer.results)


def answer_of(job: FlightJob, answer: JobAnswer | JobFailure) -> JobAnswer:
    """Return a pool's answer of a job; that of a job that failed has aborted cells."""
    return aborted_answer(job, answer.reason) if isinstance(answer, JobFailure) else answer


def run_campaign(plan: CampaignPlan, folder: Path, workers: int, args: argparse.Namespace) -> int:
    """Fly the missing cells, then write and print the results, also after Ctrl-C.

    Returns
    -------
    int
        The number of cells that failed.
    """
    campaign = plan.campaign
    store = ResultsStore(folder, campaign)
    pool = open_worker_pool(workers, args.ray, campaign.flight_limit_s)
    try:
        with WorkProgress("flying", plan.max_cells, "cells") as progress:
            heat_map = LiveHeatMap(folder, plan)

            worst = list(store.results.values())

            def show(results: list[CellResult]) -> None:
                worst[:] = [max(worst + results, key=lambda one: outcome_rank(one.outcome))]
                text = f"worst: {worst[0].outcome} ({worst[0].cell.fault})"
                progress.show(len(store.results), text)
                heat_map.show(results)

            CampaignRun(plan, pool, store, show).run_all()
    finally:
        pool.close()
        store.close()
        # There may be no results if the first flight was refused.
        if store.results:
            summary = {**write_report(folder, plan), "folder": folder}
            print_result(args, summary, lambda: print_outcomes(folder, plan))
    return sum(campaign.fails(result) for result in store.results.values())
