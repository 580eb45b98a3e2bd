"""Epochs that pass in one call against the same judged step by step."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run
from analysis.detection.isolation import epoch_test as epoch
from analysis.results import Decision
from analysis.samples.sample import Epoch, ImuSample, Sample


def by_steps(monkeypatch: pytest.MonkeyPatch, samples: list[Sample]) -> list[Decision]:
    """What the detector says where no epoch may pass in one call."""
    with monkeypatch.context() as patch:
        patch.setattr(epoch, "let_pass", lambda *_: None)
        return decisions(samples)


def decisions(samples: list[Sample]) -> list[Decision]:
    results = run(Detector(DetectorConfig()), samples)
    return [result for result in results if isinstance(result, Decision)]


def with_step(samples: list[Sample]) -> list[Sample]:
    """30 m on one satellite for three seconds: found, left out, let in again."""
    changed = []
    for s in samples:
        if isinstance(s, Epoch) and 14.0 <= s.t_us * 1e-6 < 17.0:
            ranges = s.pseudorange_m.copy()
            ranges[2] += 30.0
            s = replace(s, pseudorange_m=ranges)
        changed.append(s)
    return changed


@pytest.mark.parametrize("imu", [True, False])
def test_an_epoch_that_passes_says_the_same_as_step_by_step(flight, monkeypatch, imu: bool):
    part = [s for s in flight if s.t_us < 35_000_000 and (imu or not isinstance(s, ImuSample))]
    part = with_step(part)
    found, expected = decisions(part), by_steps(monkeypatch, part)
    assert len(found) == len(expected)
    assert any(decision.excluded for decision in found)
    for one, other in zip(found, expected, strict=True):
        assert (one.t_us, one.hypothesis, one.alarm) == (other.t_us, other.hypothesis, other.alarm)
        assert (one.satellites, one.excluded) == (other.satellites, other.excluded)
        assert (one.dof, one.parity_dof, one.mode) == (other.dof, other.parity_dof, other.mode)
        assert one.position_ecef_m == pytest.approx(other.position_ecef_m, abs=1e-5)
        numbers = [
            [d.statistic, d.p_value, d.parity_statistic or 0.0, d.slow_statistic or 0.0]
            for d in (one, other)
        ]
        assert np.allclose(*numbers, rtol=1e-4, atol=1e-4)
        assert np.allclose(one.normalised, other.normalised, atol=1e-4)
