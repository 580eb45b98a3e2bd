"""Quiet epochs in one call against the same judged step by step: the same numbers, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.isolation import epoch_test
from analysis.detection.isolation.quiet_epoch import quiet_epoch
from analysis.results import Result, encode_lines
from analysis.samples.sample import Epoch, ImuSample, Sample


def results(samples: list[Sample]) -> list[Result]:
    return run_detector(Detector(DetectorConfig()), samples)


def with_step(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Metres on one satellite for three seconds, found and readmitted; noise on all of them."""
    changed: list[Sample] = []
    for s in samples:
        if isinstance(s, Epoch):
            ranges = s.pseudorange_m + rng.normal(0.0, 0.2, len(s.satellites))
            if 14.0 <= s.t_us * 1e-6 < 17.0:
                ranges[2] += 30.0
            s = replace(s, pseudorange_m=ranges)
        changed.append(s)
    return changed


@pytest.mark.parametrize(("imu", "seed"), [(True, 1), (False, 2)])
def test_a_quiet_epoch_gives_the_bytes_of_one_judged_step_by_step(
    flight, monkeypatch, imu: bool, seed: int
):
    part = [s for s in flight if s.t_us < 35_000_000 and (imu or not isinstance(s, ImuSample))]
    part = with_step(part, np.random.default_rng(seed))
    quiet = []

    def counted(*args):
        found = quiet_epoch(*args)
        quiet.append(found is not None)
        return found

    monkeypatch.setattr(epoch_test, "quiet_epoch", counted)
    found = results(part)
    assert 0.2 < np.mean(quiet) < 1.0
    monkeypatch.setattr(epoch_test, "quiet_epoch", lambda *_: None)
    assert encode_lines(results(part)) == encode_lines(found)
