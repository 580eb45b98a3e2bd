"""The position reference: all its forms, and interpolation."""

import numpy as np
import pytest

from analysis.recordings.position_reference import read_reference
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth import ecef_from_geodetic

WEEK_US = 604_800_000_000
PLACE_M = ecef_from_geodetic(np.radians(35.0), np.radians(139.0), 60.0)


def test_a_point_is_valid_at_all_times():
    metres = ",".join(f"{x:.4f}" for x in PLACE_M)
    for given in (metres, "35,139,60"):
        reference = read_reference(given)
        assert reference.at(5 * WEEK_US) == pytest.approx(PLACE_M, abs=1e-3)


def test_a_position_file_of_rtklib_is_read(tmp_path):
    path = tmp_path / "rover.pos"
    path.write_text(
        "%  GPST   latitude(deg) longitude(deg)  height(m)   Q  ns\n"
        "2021/03/19 12:00:00.000   35.000000000  139.000000000   60.0000   1  19\n"
    )
    assert read_reference(str(path)).t_us.tolist() == [2149 * WEEK_US + 475_200_000_000]


@pytest.mark.parametrize("separator", [",", " "])
def test_a_table_of_weeks_and_seconds_is_read(tmp_path, separator):
    path = tmp_path / "truth.csv"
    rows = [("2149", "10", "35", "139", "60"), ("2149", "11", "35", "139", "62")]
    text = "week,tow_s,lat_deg,lon_deg,height_m\n" if separator == "," else ""
    path.write_text(text + "".join(separator.join(row) + "\n" for row in rows))
    reference = read_reference(str(path))
    assert reference.at(2149 * WEEK_US + 10_000_000) == pytest.approx(PLACE_M, abs=1e-6)
    half = reference.at(2149 * WEEK_US + 10_500_000)
    assert np.linalg.norm(np.subtract(half, PLACE_M)) == pytest.approx(1.0, abs=1e-6)


def test_far_from_any_known_position_the_reference_is_unknown(tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text("2149,10,35,139,60\n2149,20,35,139,60\n")
    reference = read_reference(str(path))
    assert reference.at(2149 * WEEK_US + 15_000_000) is None
    assert reference.at(2149 * WEEK_US + 21_000_000) is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("%  UTC  latitude(deg)\n", "write it in GPST"),
        ("% nothing\n", "has no position"),
        ("1,2,3\n", "cannot be read"),
        ("2149,10,95,139,60\n", "not latitude"),
    ],
)
def test_an_invalid_reference_is_refused(tmp_path, text, why):
    path = tmp_path / "truth.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=why):
        read_reference(str(path))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_reference(str(tmp_path / "absent.pos"))
