"""The noise that a recording shows: by system, robust against faults, written and read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls

from analysis.detection import DetectorConfig
from analysis.detection.learn_noise import (
    RecordedNoise,
    _fit_positive,
    learn_noise,
    read_sigma,
    write_sigma,
)
from analysis.samples.sample import Epoch, ImuSample, Sample
from mavproxy_fault.documents.errors import ConfigError


@pytest.fixture(scope="module")
def ranges(flight: list[Sample]) -> list[Sample]:
    """A minute of clean flight without its IMU, at one epoch a second."""
    return [
        s
        for s in flight
        if not isinstance(s, ImuSample)
        and not (isinstance(s, Epoch) and s.t_us // 100_000 % 10 != 0)
    ]


def learn(samples: list[Sample]) -> RecordedNoise:
    found = learn_noise(samples, DetectorConfig())
    assert found is not None
    return found


def with_errors(
    samples: list[Sample], sigma_m: float, of: str, seed: int = 1, standing: bool = False
) -> list[Sample]:
    """The samples with more noise on a system's ranges, the same at all epochs if `standing`."""
    rng, out = np.random.default_rng(seed), list[Sample]()
    for s in samples:
        if isinstance(s, Epoch):
            rng = np.random.default_rng(seed) if standing else rng
            mine = np.array([name[0] in of for name in s.satellites])
            noise = sigma_m * mine * rng.standard_normal(len(mine))
            s = replace(s, pseudorange_m=s.pseudorange_m + noise)
        out.append(s)
    return out


def sigma_in_zenith(found: RecordedNoise, kind: int) -> float:
    one = found.sigma.sigma_m(np.array([np.pi / 2]), np.array([45.0]))[0]
    return float(found.sigma.systems[kind] * one)


def test_the_learnt_noise_is_that_of_the_recording_and_of_each_system(ranges):
    clean, noisy = learn(ranges), learn(with_errors(ranges, 6.0, "E"))
    assert clean.chi_square_per_dof == pytest.approx(0.9, abs=0.15)
    assert sigma_in_zenith(noisy, 1) > 4.0 > 2.0 > sigma_in_zenith(noisy, 0)
    assert noisy.sigma.rate_mps == pytest.approx(clean.sigma.rate_mps, rel=0.3)


def test_a_fault_is_not_learnt_as_noise(ranges):
    clean = learn(ranges)
    begin_us = next(s.t_us for s in ranges if isinstance(s, Epoch))
    name = next(s.satellites[0] for s in ranges if isinstance(s, Epoch))
    faulty = []
    for s in ranges:
        if isinstance(s, Epoch) and s.t_us - begin_us >= 30e6 and name in s.satellites:
            shift = 50.0 * np.array([one == name for one in s.satellites])
            s = replace(s, pseudorange_m=s.pseudorange_m + shift)
        faulty.append(s)
    for kind in (0, 1):
        assert sigma_in_zenith(learn(faulty), kind) < 1.8 * sigma_in_zenith(clean, kind)


def test_noise_that_lasts_for_seconds_is_told_from_white_noise_and_from_standing_offsets(ranges):
    rng, sizes_m, out = np.random.default_rng(3), dict[str, float](), list[Sample]()
    stays = np.exp(-1.0 / 6.0)
    for s in ranges:
        if isinstance(s, Epoch):
            for name in s.satellites:
                fresh_m = 5.0 * rng.standard_normal()
                known = sizes_m.get(name)
                moved_m = fresh_m if known is None else stays * known + 0.532 * fresh_m
                sizes_m[name] = moved_m
            shift = np.array([sizes_m[name] for name in s.satellites])
            s = replace(s, pseudorange_m=s.pseudorange_m + shift)
        out.append(s)
    lasting, white = learn(out).sigma, learn(with_errors(ranges, 5.0, "GE")).sigma
    standing = learn(with_errors(ranges, 5.0, "GE", standing=True)).sigma
    assert 3.0 <= lasting.lasting_s <= 16.0
    assert lasting.thermal_m < 0.6 * lasting.floor_m + lasting.zenith_m
    assert white.lasting_s == standing.lasting_s == 0.0
    assert "floor and zenith last" in learn(out).describe()


def test_no_receiver_is_trusted_beyond_half_the_model(ranges):
    found, model = learn(ranges), DetectorConfig().sigma
    assert min(found.sigma.systems[:2]) > 0.3
    assert sigma_in_zenith(found, 0) > 0.4 * model.sigma_m(np.array([1.57]), np.array([45.0]))[0]


def test_what_was_learnt_is_written_and_read_back(ranges, tmp_path: Path):
    found = learn(ranges)
    write_sigma(tmp_path / "sigma.yaml", found)
    assert read_sigma(tmp_path / "sigma.yaml") == found.sigma
    assert f"learnt from {found.ranges} ranges" in (tmp_path / "sigma.yaml").read_text()


def test_nothing_is_learnt_from_too_little_data(ranges):
    few = [s for s in ranges if not isinstance(s, Epoch) or s.t_us < 5_000_000]
    assert learn_noise(few, DetectorConfig()) is None


def test_a_file_without_a_sigma_is_refused(tmp_path: Path):
    (tmp_path / "x.yaml").write_text("a: 1\n")
    with pytest.raises(ConfigError, match="has no `sigma`"):
        read_sigma(tmp_path / "x.yaml")
    (tmp_path / "y.yaml").write_text("sigma: {scala: 1}\n")
    with pytest.raises(ConfigError, match="scala is unknown"):
        read_sigma(tmp_path / "y.yaml")


def test_a_fit_without_negative_terms_is_that_of_scipy():
    rng = np.random.default_rng(5)
    for _ in range(50):
        a, b = rng.normal(size=(9, 3)), rng.normal(size=9)
        assert _fit_positive(a, b) == pytest.approx(nnls(a, b)[0], abs=1e-12)
