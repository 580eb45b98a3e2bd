"""NMEA sentences of a solution, read back by pynmeagps."""

from dataclasses import replace
from datetime import UTC, date, datetime, time
from pathlib import Path

import numpy as np
import pytest
from pynmeagps import ERR_RAISE, NMEAMessage, NMEAReader

from analysis.report.nmea_file import write_nmea
from analysis.report.solution_row import SolutionRow

ROW = SolutionRow(
    datetime(2026, 11, 23, 0, 0, 10, 200_000, UTC),
    -33.8571234,
    -151.2151234,
    62.1234,
    np.array([[2.25, -1.2, 0.3], [-1.2, 6.25, 0.0], [0.3, 0.0, 16.0]]),
    ("G01", "G32", "E05", "R07", "S20", "J02"),
    (-3.0, -4.0, 0.5),
    0.8,
    1.5,
)


def sentences(row: SolutionRow, folder: Path) -> dict[str, list[NMEAMessage]]:
    """The sentences of one epoch by their names."""
    path = folder / "one.nmea"
    write_nmea(path, [row])
    found: dict[str, list[NMEAMessage]] = {}
    with path.open("rb") as file:
        for _, sentence in NMEAReader(file, quitonerror=ERR_RAISE):
            found.setdefault(sentence.msgID, []).append(sentence)
    return found


def test_position_time_and_quality_are_read_back(tmp_path: Path) -> None:
    found = sentences(ROW, tmp_path)
    (fix,), (motion,), (sigma,) = found["GGA"], found["RMC"], found["GST"]
    assert (fix.lat, fix.lon) == pytest.approx((ROW.lat_deg, ROW.lon_deg), abs=1e-9)
    assert (fix.NS, fix.EW) == ("S", "W")
    assert (fix.alt, fix.sep, fix.quality, fix.numSV, fix.HDOP) == (62.123, 0.0, 1, 6, 0.8)
    # UTC is 18 s behind, on the day before.
    assert (motion.time, motion.date) == (time(23, 59, 52, 200_000), date(2026, 11, 22))
    assert motion.spd == pytest.approx(5.0 * 3600.0 / 1852.0, abs=1e-3)
    assert motion.cog == pytest.approx(233.13)
    assert (sigma.stdLat, sigma.stdLong, sigma.stdAlt) == (1.5, 2.5, 4.0)


def test_times_between_hundredths_are_rounded(tmp_path: Path) -> None:
    late = replace(ROW, gps_time=datetime(2026, 11, 23, 0, 0, 9, 996_000, UTC))
    assert sentences(late, tmp_path)["GGA"][0].time == time(23, 59, 52)


def test_satellites_have_the_numbers_of_their_systems(tmp_path: Path) -> None:
    by_system = {
        (row.systemId, row.svid_01, row.svid_02, row.svid_03, row.PDOP)
        for row in sentences(ROW, tmp_path)["GSA"]
    }
    assert by_system == {
        ("1", 1, 32, 33, 1.7),
        ("2", 71, "", "", 1.7),
        ("3", 5, "", "", 1.7),
        ("5", 194, "", "", 1.7),
    }


def test_satellites_beyond_the_limit_are_in_a_second_sentence(tmp_path: Path) -> None:
    many = replace(ROW, satellites=tuple(f"C{n:02d}" for n in range(1, 15)))
    first, second = sentences(many, tmp_path)["GSA"]
    assert (first.svid_12, second.svid_01, second.svid_02, second.svid_03) == (12, 13, 14, "")


def test_a_position_without_a_sigma_is_no_fix(tmp_path: Path) -> None:
    found = sentences(replace(ROW, covariance_ned_m2=None), tmp_path)
    assert found["GGA"][0].quality == 0
    assert (found["RMC"][0].status, found["RMC"][0].posMode) == ("V", "N")
    assert found["GST"][0].stdLat == ""
    assert {row.navMode for row in found["GSA"]} == {1}


def test_a_position_without_satellites_is_dead_reckoned(tmp_path: Path) -> None:
    found = sentences(replace(ROW, satellites=(), velocity_ned_mps=None), tmp_path)
    assert (found["GGA"][0].quality, found["RMC"][0].posMode) == (6, "E")
    assert (found["RMC"][0].spd, found["RMC"][0].cog) == ("", "")
    assert "GSA" not in found
