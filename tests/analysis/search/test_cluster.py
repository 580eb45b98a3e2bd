"""A local Ray cluster of two workers, one of which is killed on the way."""

import os
import signal

import numpy as np
import pytest

from analysis.flying.worker_pool import RayWorkerPool
from analysis.search.evaluation.evaluation_job import EvaluationJob, evaluate_with
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.space.test_file import InitialState, TestFile

ray = pytest.importorskip("ray", reason="Ray is not installed")
TEST = TestFile(duration_s=1.0, noise_draws=2, initial=InitialState(roll_deg=(-40.0, 40.0)))


@pytest.mark.timeout(300)
@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_changes_nothing(tmp_path, monkeypatch):
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    marker = tmp_path / "killed"
    work = EvaluationJob.run

    def deadly(job):
        if job.first > 0 and not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return work(job)

    class DeadlyPool(RayWorkerPool):
        def start(self, number, job):
            super().start(number, Deadly(job))

    class Deadly:
        def __init__(self, job):
            self.job = job

        def run(self):
            return deadly(self.job)

    cluster = DeadlyPool("auto")
    try:
        points = np.linspace(0.0, 1.0, 64)[:, None]
        found = evaluate_with(cluster, TEST, points, 1, 0, 2)
    finally:
        cluster.close()
        ray.shutdown()
    assert marker.exists()
    alone = Evaluator(TEST).evaluate(points, 1, 0, 2)
    assert found.fitness.tolist() == alone.fitness.tolist()
    assert found.steps == alone.steps


def test_a_cluster_that_is_already_joined_is_left_running(monkeypatch):
    calls = []
    monkeypatch.setattr(ray, "is_initialized", lambda: True)
    monkeypatch.setattr(ray, "cluster_resources", dict)
    monkeypatch.setattr(ray, "shutdown", lambda: calls.append("shutdown"))
    RayWorkerPool("auto").close()
    assert calls == []
