"""Reading navigation files."""

from datetime import datetime
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.gnss.navigation_file import (
    SHIPPED,
    gps_time,
    parse_navigation,
    read_navigation,
    sisa_index,
    ura_index,
)


def shipped_lines() -> list[str]:
    return SHIPPED.read_text().splitlines()


def test_the_shipped_file_has_thirteen_gps_and_eleven_galileo_satellites() -> None:
    navigation = read_navigation(SHIPPED)
    letters = [name[0] for name in navigation.ephemerides]
    assert (letters.count("G"), letters.count("E")) == (13, 11)
    assert navigation.alpha == (1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8)
    assert navigation.beta == (90110.0, 0.0, -196600.0, -65540.0)


def test_a_record_has_the_values_in_the_file() -> None:
    g03 = read_navigation(SHIPPED).ephemerides["G03"][0]
    assert (g03.week, g03.toe_s, g03.toc_s, g03.iode, g03.iodc) == (2149, 475200, 475200, 37, 37)
    assert g03.af0_s == pytest.approx(-0.112356152385e-03, rel=1e-11)
    assert g03.m0_rad == pytest.approx(0.634492237240, rel=1e-11)
    assert g03.omega0_rad == pytest.approx(-1.14852075735, rel=1e-11)
    assert g03.group_delay_s == pytest.approx(0.186264514923e-08, rel=1e-11)
    assert g03.fit_half_s == 7200.0
    e01 = read_navigation(SHIPPED).ephemerides["E01"][0]
    assert (e01.accuracy, e01.fit_half_s, e01.health) == (107, 14400.0, 0)


def test_the_real_file_it_is_cut_from_reads_too(shared_data: Path) -> None:
    complete = read_navigation(shared_data / "gnss_static" / "SEPT078M.21P")
    cut = read_navigation(SHIPPED)
    assert complete.ephemerides.keys() == cut.ephemerides.keys()
    for name, sets in cut.ephemerides.items():
        assert set(sets) <= set(complete.ephemerides[name])


def test_other_systems_and_blank_lines_are_skipped() -> None:
    lines = shipped_lines()
    start = lines.index(next(line for line in lines if line.startswith("E01")))
    qzss = ["J" + lines[start][1:], *lines[start + 1 : start + 8]]
    glonass = ["R" + lines[start][1:], *lines[start + 1 : start + 4], ""]
    mixed = lines[:start] + qzss + glonass + lines[start:]
    assert parse_navigation(mixed, "x") == parse_navigation(lines, "x")


def changed(line_start: str, after: int, old: str, new: str) -> list[str]:
    lines = shipped_lines()
    at = lines.index(next(line for line in lines if line.startswith(line_start))) + after
    assert old in lines[at]
    lines[at] = lines[at].replace(old, new, 1)
    return lines


def test_fnav_and_unhealthy_satellites_are_left_out() -> None:
    fnav = changed("E01", 5, ".516000000000D+03", ".258000000000D+03")
    assert "E01" not in parse_navigation(fnav, "x").ephemerides
    sick = changed("G02", 6, "  .000000000000D+00", "  .630000000000D+02")
    assert "G02" not in parse_navigation(sick, "x").ephemerides


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ([], "x.nav:1: is not a RINEX navigation file"),
        (changed("     3.04", 0, "N: GNSS", "O: GNSS"), "x.nav:1: is not a RINEX navigation"),
        (changed("     3.04", 0, "3.04", "2.11"), "x.nav:1: RINEX 2.11 is not supported"),
        (shipped_lines()[:5], "x.nav:5: the header has no end"),
        (changed("GPSA", 0, ".7451D-08", ".7451D-xx"), "x.nav:8: '.7451D-xx' is not a number"),
        (changed("G03", 2, "D-06", "Q-06"), "Q-06' is not a number"),
        (changed("G03", 0, "2021 03 19", "2021 13 19"), "is not a time"),
        (changed("G03", 0, "G03", " 03"), "does not start a record"),
        (changed("G03", 0, "-.112356152385D-03", "-.912356152385D-00"), "cannot be broadcast"),
        (shipped_lines()[:11], "has no ephemeris"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(lines: list[str], text: str) -> None:
    with pytest.raises(ConfigError) as error:
        parse_navigation(lines, "x.nav")
    assert text in str(error.value)


def test_a_record_cut_short_is_named_with_its_line() -> None:
    lines = shipped_lines()
    at = lines.index(next(line for line in lines if line.startswith("G01")))
    with pytest.raises(ConfigError, match=rf"x.nav:{at + 6}: the record of G01 ends after 5 lines"):
        parse_navigation(lines[: at + 5] + lines[at + 8 :], "x.nav")
    with pytest.raises(ConfigError, match="ends after 3 lines; 8 lines"):
        parse_navigation(lines[: at + 3], "x.nav")


def test_a_missing_and_a_binary_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.nav: cannot be read"):
        read_navigation(tmp_path / "none.nav")
    (tmp_path / "zip.nav").write_bytes(b"\x1f\x8b\xff\xfe")
    with pytest.raises(ConfigError, match=r"zip\.nav: cannot be read"):
        read_navigation(tmp_path / "zip.nav")


def test_gps_time_counts_from_1980() -> None:
    assert gps_time(datetime(2021, 3, 19, 12)) == (2149, 475200.0)


@pytest.mark.parametrize(
    ("metres", "index"),
    [(0.0, 0), (0.49, 49), (0.5, 50), (0.98, 74), (1.0, 75), (2.0, 100), (3.12, 107), (6.0, 125),
     (7.0, 255), (-1.0, 255)],
)  # fmt: skip
def test_galileo_accuracy_has_the_index_of_its_standard(metres: float, index: int) -> None:
    assert sisa_index(metres) == index


@pytest.mark.parametrize(("metres", "index"), [(2.0, 0), (2.4, 0), (2.8, 1), (6144, 14), (9e3, 15)])
def test_gps_accuracy_has_the_index_of_its_standard(metres: float, index: int) -> None:
    assert ura_index(metres) == index
