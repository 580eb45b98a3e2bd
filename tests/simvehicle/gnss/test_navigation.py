"""Reading navigation files."""

import gzip
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.navigation_record import sisa_index, ura_index
from simvehicle.gnss.constellation import SHIPPED, Ephemerides, read_navigation


def shipped_lines() -> list[str]:
    return SHIPPED.read_text().splitlines()


def test_the_shipped_file_has_thirteen_gps_and_eleven_galileo_satellites() -> None:
    ephemerides, klobuchar = read_navigation(SHIPPED)
    letters = [name[0] for name in ephemerides]
    assert (letters.count("G"), letters.count("E")) == (13, 11)
    assert klobuchar[:4] == (1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8)
    assert klobuchar[4:] == (90110.0, 0.0, -196600.0, -65540.0)


def test_a_record_has_the_values_in_the_file() -> None:
    g03 = read_navigation(SHIPPED)[0]["G03"][0]
    assert (g03.week, g03.toe_s, g03.toc_s, g03.iode, g03.iodc) == (2149, 475200, 475200, 37, 37)
    assert g03.af0_s == pytest.approx(-0.112356152385e-03, rel=1e-11)
    assert g03.m0_rad == pytest.approx(0.634492237240, rel=1e-11)
    assert g03.omega0_rad == pytest.approx(-1.14852075735, rel=1e-11)
    assert g03.group_delay_s == pytest.approx(0.186264514923e-08, rel=1e-11)
    assert g03.fit_half_s == 7200.0
    e01 = read_navigation(SHIPPED)[0]["E01"][0]
    assert (e01.accuracy, e01.fit_half_s, e01.health) == (107, 14400.0, 0)


def test_the_real_file_it_is_cut_from_reads_too(shared_data: Path) -> None:
    complete, _ = read_navigation(shared_data / "gnss_static" / "SEPT078M.21P")
    cut, _ = read_navigation(SHIPPED)
    assert complete.keys() == cut.keys()
    for name, sets in cut.items():
        assert set(sets) <= set(complete[name])


def parsed(lines: list[str], folder: Path) -> tuple[Ephemerides, tuple[float, ...]]:
    path = folder / "x.nav"
    path.write_text("\n".join(lines) + "\n")
    return read_navigation(path)


def test_other_systems_and_blank_lines_are_skipped(tmp_path: Path) -> None:
    lines = shipped_lines()
    start = lines.index(next(line for line in lines if line.startswith("E01")))
    qzss = ["J" + lines[start][1:], *lines[start + 1 : start + 8]]
    glonass = ["R" + lines[start][1:], *lines[start + 1 : start + 4], ""]
    mixed = lines[:start] + qzss + glonass + lines[start:]
    assert parsed(mixed, tmp_path) == parsed(lines, tmp_path)


def changed(line_start: str, after: int, old: str, new: str) -> list[str]:
    lines = shipped_lines()
    at = lines.index(next(line for line in lines if line.startswith(line_start))) + after
    assert old in lines[at]
    lines[at] = lines[at].replace(old, new, 1)
    return lines


def test_fnav_and_unhealthy_satellites_are_left_out(tmp_path: Path) -> None:
    fnav = changed("E01", 5, ".516000000000D+03", ".258000000000D+03")
    assert "E01" not in parsed(fnav, tmp_path)[0]
    sick = changed("G02", 6, "  .000000000000D+00", "  .630000000000D+02")
    assert "G02" not in parsed(sick, tmp_path)[0]


@pytest.mark.parametrize("source", [1, 4, 5, 513, 516, 517, 3, 0])
def test_sources_with_inav_are_kept(source: int, tmp_path: Path) -> None:
    inav = changed("E01", 5, ".516000000000D+03", f"{source:17.1f}")
    found = parsed(inav, tmp_path)[0]["E01"][0]
    assert found == read_navigation(SHIPPED)[0]["E01"][0]


def test_a_damaged_record_costs_itself_only(tmp_path: Path) -> None:
    whole = read_navigation(SHIPPED)[0]
    damages = [
        changed("G03", 2, "D-06", "Q-06"),
        changed("G03", 0, "2021 03 19", "2021 13 19"),
        changed("G03", 0, "-.112356152385D-03", "-.912356152385D-00"),
        changed("G03", 0, "G03", " 03"),
    ]
    for lines in damages:
        left = parsed(lines, tmp_path)[0]
        assert {name: whole[name] for name in whole if name != "G03"} == {
            name: sets for name, sets in left.items() if name != "G03"
        }
        assert len(left.get("G03", ())) == len(whole["G03"]) - 1


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (["hello"], "x.nav: is not a RINEX file"),
        (changed("     3.04", 0, "N: GNSS", "O: GNSS"), "x.nav: has type 'O'; give a navigation"),
        (shipped_lines()[:5], "x.nav: has no END OF HEADER"),
        (changed("GPSA", 0, ".7451D-08", ".7451D-xx"), "ionosphere field is not a number"),
        (shipped_lines()[:11], "has no ephemeris"),
    ],
)
def test_a_wrong_file_is_refused(lines: list[str], text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        parsed(lines, tmp_path)
    assert text in str(error.value)


def test_compressed_files_and_rinex_4_are_read_alike(tmp_path: Path) -> None:
    packed, four = tmp_path / "a.nav.gz", tmp_path / "b.rnx"
    packed.write_bytes(gzip.compress(SHIPPED.read_bytes()))
    lines = [
        line
        for old in [SHIPPED.read_text().replace(" 3.04 ", " 4.01 ", 1)]
        for line in old.splitlines()
    ]
    with_heads = []
    for line in lines:
        if line[:1] in "GE":
            with_heads.append(f"> EPH {line[:3]} {'LNAV' if line[0] == 'G' else 'INAV'}")
        with_heads.append(line)
    four.write_text("\n".join(with_heads) + "\n")
    whole = read_navigation(SHIPPED)
    assert read_navigation(packed) == whole
    assert read_navigation(four)[0] == whole[0]


def test_rinex_2_is_read_like_rinex_3(tmp_path: Path) -> None:
    lines = shipped_lines()
    start = next(i for i, line in enumerate(lines) if "END OF HEADER" in line) + 1
    two = [
        f"{'     2.11           N: GPS NAV DATA':<60}RINEX VERSION / TYPE",
        " " * 60 + "END OF HEADER",
    ]
    keep = False
    for line in lines[start:]:
        if line[:1] != " ":
            keep = line[0] == "G"
            stamp = [int(word) for word in line[4:23].split()]
            line = (
                f" {line[1:3]} {stamp[0] % 100:02d}"
                + "".join(f" {k:2d}" for k in stamp[1:5])
                + f"{stamp[5]:5.1f}"
                + line[23:]
            )
        if keep:
            two.append(line[1:])
    whole = read_navigation(SHIPPED)[0]
    assert parsed(two, tmp_path)[0] == {n: e for n, e in whole.items() if n[0] == "G"}


def test_a_missing_and_a_binary_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.nav: No such file"):
        read_navigation(tmp_path / "none.nav")
    (tmp_path / "zip.nav").write_bytes(b"\x1f\x8b\xff\xfe")
    with pytest.raises(ConfigError, match=r"zip\.nav: is not a RINEX file"):
        read_navigation(tmp_path / "zip.nav")


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
