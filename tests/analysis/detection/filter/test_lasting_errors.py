"""Lasting errors in the reported covariance: against algebra, and at a real position."""

import math

import msgspec
import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.lasting_errors import (
    IONOSPHERE_SHARE,
    LASTING_SIGNAL_M,
    TROPOSPHERE_M,
    VarianceFactor,
)
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.detection.learn_noise import learn_noise
from analysis.detection.protection_levels import bound_position
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.block import block_of
from analysis.samples.sample import Epoch, IonosphereSample
from analysis.scoring.position_scores import PositionScores

ANTENNA_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])  # of the data's README


@pytest.fixture(scope="module")
def static(shared_data):
    folder = shared_data / "gnss_static"
    return read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")


def over_sigma(samples, config):
    """Percentiles of the error over its sigma."""
    detector, scores = Detector(config), PositionScores()
    state = detector.new_state()
    for sample in samples:
        results, state = detector.step(sample, state)
        for result in results:
            if isinstance(result, Decision) and result.position_ecef_m is not None:
                scores.add("filter", result.position_ecef_m, result.position_sigma_m, ANTENNA_M)
    found = scores.summary()["filter"]
    return found["over_sigma_50"], found["over_sigma_95"]


@pytest.mark.parametrize("systems", ["G", "GE"])
def test_errors_over_sigma_are_honest_by_default_and_calibrated_on_the_half_before(static, systems):
    config = DetectorConfig(systems=systems)
    stamps = [s.t_us for s in static if isinstance(s, Epoch)]
    middle_us = (stamps[0] + stamps[-1]) // 2
    first = [s for s in static if not isinstance(s, Epoch) or s.t_us < middle_us]
    second = [s for s in static if not isinstance(s, Epoch) or s.t_us >= middle_us]
    calibrated = msgspec.structs.replace(config, sigma=learn_noise(first, config).sigma)
    for samples, judged_with in ((static, config), (second, calibrated)):
        half, most = over_sigma(samples, judged_with)
        assert 0.7 <= half <= 1.5
        assert most < 3.0


def test_typical_coefficients_make_the_position_less_certain_than_broadcast_ones(static):
    kept = [s for s in static if not isinstance(s, IonosphereSample)]
    assert len(kept) < len(static)
    sent, none = (sigmas(samples) for samples in (first(static), first(kept)))
    assert np.all(none > 1.2 * sent)


def test_coefficients_of_the_user_count_as_broadcast(static):
    kept = first([s for s in static if not isinstance(s, IonosphereSample)])
    typical = DetectorConfig().ionosphere
    a_little_other = (typical[0] * 1.0001, *typical[1:])
    own = sigmas(kept, DetectorConfig(ionosphere=a_little_other))
    assert np.all(own < 0.8 * sigmas(kept))


def first(samples, epochs=60):
    """The samples up to an epoch."""
    ends = [i for i, s in enumerate(samples) if isinstance(s, Epoch)]
    return samples[: ends[epochs]]


def sigmas(samples, config=None):
    """The positions' sigmas (n,) in m."""
    detector = Detector(config or DetectorConfig())
    results, _ = detector.step(block_of(samples), detector.new_state())
    sigmas = [r.position_sigma_m for r in results if isinstance(r, Decision)]
    return np.linalg.norm([sigma for sigma in sigmas if sigma is not None], axis=1)


def test_calibration_works_on_epochs_of_every_thirty_seconds(static):
    first_us = next(s.t_us for s in static if isinstance(s, Epoch))
    sparse = [
        s for s in static if not isinstance(s, Epoch) or (s.t_us - first_us) % 30_000_000 == 0
    ]
    found = learn_noise(sparse, DetectorConfig())
    assert found.epochs == 30
    # Residuals beyond five sigmas count for five: a standing one of GPS has six.
    assert found.chi_square_per_dof == pytest.approx(1.15, abs=0.25)


def test_lasting_errors_are_mapped_by_the_snapshot(static):
    first = next(i for i, s in enumerate(static) if isinstance(s, Epoch))
    detector = Detector()
    _, state = detector.step(static[: first + 1], detector.new_state())
    epoch, ionosphere = static[first], state.core.broadcast.ionosphere
    observed = observe_epoch(
        epoch, select_ephemerides(epoch, state.core.broadcast.ephemerides, "GE")
    )
    x = np.zeros(X_SIZE)
    x[:3] = ANTENNA_M
    used = predict_innovations(observed, x, DetectorConfig().sigma, ionosphere)
    misfit = VarianceFactor(total=30.0, dof=10.0)
    found = bound_position(used, np.zeros(3), np.zeros(len(used.range_m)), ANTENNA_M, misfit, 1.0)
    gps = np.array([name[0] == "G" for name in observed.satellites], dtype=float)
    design = np.column_stack([used.geometry[:, :3], gps, 1.0 - gps])
    weight = 1.0 / used.variance
    response = np.linalg.inv(design.T * weight @ design) @ (design.T * weight)
    wet_m = TROPOSPHERE_M * 1.001 / np.sqrt(0.002001 + np.sin(used.elevation_rad) ** 2)
    lasts = LASTING_SIGNAL_M**2 + (IONOSPHERE_SHARE * used.ionosphere_m) ** 2 + wet_m**2
    lasts += (3.0 - 1.0) * used.variance
    expected = response[:3] * lasts @ response[:3].T
    assert found.factor == 3.0
    assert found.lasting_m2 == pytest.approx(expected, rel=1e-2, abs=1e-3)


def test_the_variance_factor_has_a_memory_of_a_minute_and_counts_no_second_twice():
    misfit = VarianceFactor()
    assert misfit.factor == 1.0
    slow = fast = misfit
    for _ in range(60):
        slow = slow.with_epoch(parity=50.0, dof=10, dt_s=1.0)
    for _ in range(600):
        fast = fast.with_epoch(parity=50.0, dof=10, dt_s=0.1)
    assert slow.factor == pytest.approx(4.9, abs=0.1)
    assert fast.factor == pytest.approx(slow.factor, abs=0.05)
    for _ in range(300):
        slow = slow.with_epoch(parity=10.0, dof=10, dt_s=1.0)
    assert slow.factor == pytest.approx(1.0, abs=0.05)
    assert math.isclose(VarianceFactor(1.0, 100.0).factor, 0.25)
