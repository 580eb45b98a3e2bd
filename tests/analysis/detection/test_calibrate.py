"""The sigma model fitted to clean data, written and read."""

from pathlib import Path

import pytest

from analysis.detection import DetectorConfig
from analysis.detection.calibrate import calibrate_sigma, read_sigma, write_sigma
from analysis.samples.sample import Epoch, ImuSample
from mavproxy_fault.documents.errors import ConfigError


def test_clean_chi_square_per_degree_of_freedom_becomes_one(flight, tmp_path: Path):
    part = [s for s in flight if not isinstance(s, ImuSample)]
    found = calibrate_sigma(part, DetectorConfig())
    assert found.chi_square_per_dof == pytest.approx(1.0, abs=0.1)
    write_sigma(tmp_path / "sigma.yaml", found)
    assert read_sigma(tmp_path / "sigma.yaml").scale == pytest.approx(found.sigma.scale, abs=1e-4)


def test_too_little_data_is_refused(flight):
    few = [s for s in flight if not isinstance(s, Epoch) or s.t_us < 2_000_000]
    with pytest.raises(ConfigError, match="at least 20"):
        calibrate_sigma(few, DetectorConfig())


def test_a_file_without_a_sigma_is_refused(tmp_path: Path):
    (tmp_path / "x.yaml").write_text("a: 1\n")
    with pytest.raises(ConfigError, match="has no `sigma`"):
        read_sigma(tmp_path / "x.yaml")
    (tmp_path / "y.yaml").write_text("sigma: {scala: 1}\n")
    with pytest.raises(ConfigError, match="scala is unknown"):
        read_sigma(tmp_path / "y.yaml")
