import multiprocessing
import os
import time
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest

from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.campaign_run import answer_of
from analysis.flying import worker_pool
from analysis.flying.worker_pool import JobFailure, LocalWorkerPool, RayWorkerPool
from mavproxy_fault.documents.errors import ConfigError

SMALL = read_campaign(Path(__file__).parents[1] / "campaign" / "small.yaml")
LONG = msgspec.structs.replace(SMALL, folder=str(Path(__file__).parents[1] / "campaign"))


def test_a_hung_flight_is_ended_and_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_pool, "compiled_last_s", lambda: 0.0)
    fleet = LocalWorkerPool(1, 0.01)
    (job,) = CampaignPlan(LONG).reference_jobs().values()
    try:
        fleet.start(7, job)
        number, answer = fleet.finished()
    finally:
        fleet.close()
    assert (number, answer) == (7, JobFailure("hung: not over after 0.01 s"))
    (result, *_) = answer_of(job, answer).results
    assert (result.outcome, result.note) == ("aborted", answer.reason)


class Waiting(NamedTuple):
    """A job that ends when somebody writes into a pipe."""

    pipe: Path

    def run(self) -> str:
        return self.pipe.read_text()


def test_kernels_that_are_compiled_do_not_count_as_time_of_a_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    asked = []

    def compiled_last_s() -> float:
        asked.append(time.time())
        if len(asked) == 2:  # twice over the limit, while kernels are compiled
            pipe.write_text("flown")
        return time.time()

    monkeypatch.setattr(worker_pool, "compiled_last_s", compiled_last_s)
    fleet = LocalWorkerPool(1, 0.01)
    try:
        fleet.start(1, Waiting(pipe))
        assert fleet.finished() == (1, "flown")
    finally:
        fleet.close()


def test_a_process_that_dies_is_reported(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "short.yaml")
    campaign = msgspec.structs.replace(SMALL, folder=str(tmp_path))
    (job,) = CampaignPlan(campaign).reference_jobs().values()
    fleet = LocalWorkerPool(1, 60.0)
    try:
        fleet.start(1, job)
        with (tmp_path / "short.yaml").open("w"):  # opens once the worker reads the scenario
            multiprocessing.active_children()[0].kill()
            _, answer = fleet.finished()
    finally:
        fleet.close()
    assert "died with code" in answer.reason


def test_a_missing_ray_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(ConfigError, match="Ray is not installed"):
        RayWorkerPool("local", 60.0)
