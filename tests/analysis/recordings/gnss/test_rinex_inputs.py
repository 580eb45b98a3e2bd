"""RINEX and IMU files as people have them: several, cut, of other days, with odd lines."""

import gzip
import json
import re
from pathlib import Path

import pytest

from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.rinex_observations import read_observations
from analysis.recordings.read_recordings import read_rinex, read_rinex_samples
from analysis.samples.sample import EphemerisSample, ImuSample
from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError

QZSS = Path(__file__).parents[3] / "data/gnss_qzss"


def line(text: str, label: str) -> str:
    return f"{text:<60}{label}\n"


HEADER_3 = (
    line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    + line("G    2 C1C S1C", "SYS / # / OBS TYPES")
    + line("E    3 C1C C1X S1X", "SYS / # / OBS TYPES")
    + line("C    2 C2I C6I", "SYS / # / OBS TYPES")
    + line("", "END OF HEADER")
)


def epoch(second: int, count: int, *rows: str) -> str:
    head = f"> 2021 03 19 12 00 {second:2d}.0000000  0 {count:2d}\n"
    return head + "".join(f"{row}\n" for row in rows)


def fields(name: str, *values: float | None) -> str:
    return name + "".join(" " * 16 if v is None else f"{v:14.3f}  " for v in values)


@pytest.fixture
def walk(shared_data: Path) -> Path:
    return shared_data / "gnss_imu_walk"


def test_a_satellite_without_the_preferred_signal_is_read_on_the_next(tmp_path: Path):
    path = tmp_path / "a.rnx"
    gps, galileo = fields("G05", 2.1e7, 44.0), fields("E11", None, 2.4e7, 41.0)
    path.write_text(HEADER_3 + epoch(0, 2, gps, galileo))
    (only,) = read_observations(path)
    assert only.satellites == ("G05", "E11")
    assert only.pseudorange_m.tolist() == [2.1e7, 2.4e7]
    assert only.cn0_dbhz.tolist() == [44.0, 41.0]


def test_a_satellite_keeps_its_carrier(tmp_path: Path):
    path = tmp_path / "a.rnx"
    first, second = fields("C21", 2.2e7, 2.3e7), fields("C21", None, 2.3e7)
    gps = fields("G05", 2.1e7, 44.0)
    path.write_text(HEADER_3 + epoch(0, 2, gps, first) + epoch(1, 2, gps, second))
    one, two = read_observations(path)
    assert one.satellites == ("G05", "C21")
    assert two.satellites == ("G05",)


def test_a_wrong_satellite_count_costs_no_other_epoch(tmp_path: Path):
    path = tmp_path / "a.rnx"
    gps = fields("G05", 2.1e7, 44.0)
    path.write_text(HEADER_3 + epoch(0, 9, gps) + epoch(1, 1, gps) + epoch(2, 1, gps))
    assert [round(e.tow_s) % 60 for e in read_observations(path)] == [0, 1, 2]


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path: Path):
    path = tmp_path / "a.rnx"
    text = HEADER_3 + epoch(0, 1, fields("G05", 2.1e7, 44.0))
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert len(read_observations(path)) == 1


@pytest.mark.parametrize("name", ["a.21o.gz", "a.crx", "a.crx.gz"])
def test_a_truncated_compressed_file_is_refused_in_one_line(tmp_path: Path, name: str):
    path = tmp_path / name
    packed = gzip.compress((HEADER_3 + epoch(0, 1, fields("G05", 2.1e7, 44.0))).encode())
    path.write_bytes(packed[:40] if name.endswith("gz") else b"1.0   COMPACT RINEX FORMAT\ncut")
    with pytest.raises(ConfigError, match=r"cannot be decompressed|is not a RINEX file"):
        read_observations(path)


def test_a_version_that_is_no_number_is_refused(tmp_path: Path):
    path = tmp_path / "a.rnx"
    path.write_text(HEADER_3.replace("3.04", "x.04"))
    with pytest.raises(ConfigError, match=r"version 'x.04'; supported: 2.00 to 4.02"):
        read_observations(path)


def test_an_ionosphere_field_that_is_no_number_is_refused(tmp_path: Path, walk: Path):
    path = tmp_path / "a.nav"
    lines = (walk / "walk_ex.nav").read_text().splitlines(keepends=True)
    correction = line("GPSA   1.1E-08  junk       0.0         0.0", "IONOSPHERIC CORR")
    path.write_text(lines[0] + correction + "".join(lines[1:]))
    with pytest.raises(ConfigError, match="ionosphere field is not a number"):
        read_navigation(path)


def test_navigation_files_add_up(tmp_path: Path, walk: Path):
    def records(text: str, system: str) -> str:
        head, end, body = text.partition("END OF HEADER")
        blocks, keep = [], False
        for row in body.splitlines(keepends=True)[1:]:
            keep = row.startswith(system) if row[0] != " " else keep
            blocks.append(row if keep else "")
        return f"{head}{end}\n" + "".join(blocks)

    text = (walk / "walk_ex.nav").read_text()
    parts = [tmp_path / "gps.nav", tmp_path / "galileo.nav"]
    for path, system in zip(parts, "GE", strict=True):
        path.write_text(records(text, system))
    samples = read_rinex_samples(walk / "walk_ex.obs", parts)
    systems = {s.ephemeris.satellite[0] for s in samples if isinstance(s, EphemerisSample)}
    assert systems == {"G", "E"}


def records_of(system: str) -> str:
    """The header of a navigation file, and the records of one system."""
    head, body = (QZSS / "base.nav").read_text().split("END OF HEADER")
    rows = body.splitlines(keepends=True)[1:]
    starts = [i for i, row in enumerate(rows) if row[:1] == system]
    return head + "END OF HEADER\n" + "".join("".join(rows[i : i + 8]) for i in starts)


def test_the_command_takes_a_navigation_file_of_each_system(tmp_path: Path):
    parts = [tmp_path / "gps.nav", tmp_path / "galileo.nav"]
    for path, system in zip(parts, "GE", strict=True):
        path.write_text(records_of(system))
    files, out = [str(QZSS / "base.obs"), *map(str, parts)], tmp_path / "run"
    # One epoch in ten is the untested start: no PASS, but no error either.
    assert main(["monitor", "--rinex", *files, "--zenoh", "off", "--out", str(out)]) in (0, 1)
    rows = [json.loads(row) for row in (out / "results.jsonl").read_text().splitlines()]
    last = [row for row in rows if row["type"] == "Decision"][-1]
    assert {name[0] for name in last["satellites"]} == {"G", "E"}


def test_the_command_ends_in_a_one_line_error_without_usable_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    obs, nav = QZSS / "base.obs", tmp_path / "a.nav"
    empty = tmp_path / "a.obs"
    empty.write_text(obs.read_text().split("> ")[0])
    records = records_of("G")
    # The clock's reference time, so that each orbit's time moves with it.
    other_week = re.sub(r"(?m)^(G\d\d 2024 06) 2\d", r"\1 10", records)
    assert other_week != records
    cases = [
        (obs, other_week, "give the navigation file of that day"),
        (obs, records_of("C"), "no readable ephemeris"),
        (empty, records, "no epoch has"),
    ]
    for observations, orbits, words in cases:
        nav.write_text(orbits)
        assert main(["monitor", "--rinex", str(observations), str(nav), "--zenoh", "off"]) == 2
        assert words in capsys.readouterr().err


def test_navigation_of_another_day_is_refused(shared_data: Path, walk: Path):
    with pytest.raises(ConfigError, match="give the navigation file of that day"):
        read_rinex(walk / "walk_ex.obs", shared_data / "gnss_static/SEPT078M.21P")


def test_observations_without_an_epoch_are_refused(tmp_path: Path, walk: Path):
    path = tmp_path / "a.obs"
    path.write_text(HEADER_3)
    with pytest.raises(ConfigError, match="no epoch has"):
        read_rinex(path, walk / "walk_ex.nav")


def test_a_navigation_file_without_an_orbit_is_refused(tmp_path: Path, walk: Path):
    path = tmp_path / "a.nav"
    head, end, _ = (walk / "walk_ex.nav").read_text().partition("END OF HEADER")
    path.write_text(f"{head}{end}\n")
    with pytest.raises(ConfigError, match="no readable ephemeris"):
        read_rinex(walk / "walk_ex.obs", path)


def imu_lines(walk: Path) -> list[str]:
    return (walk / "imu_1730_sf.csv").read_text().splitlines(keepends=True)[:400]


@pytest.mark.parametrize("head", ["", "time,ax,ay,az,gx,gy,gz,a,b,c\n"])
def test_an_imu_file_may_have_a_header_and_a_byte_order_mark(head: str, tmp_path: Path, walk: Path):
    path = tmp_path / "imu.csv"
    path.write_text(f"\ufeff{head}" + "".join(imu_lines(walk)))
    samples = read_rinex_samples(walk / "walk_ex.obs", walk / "walk_ex.nav", path)
    assert sum(isinstance(s, ImuSample) for s in samples) == 400


def test_an_imu_of_another_year_is_refused(tmp_path: Path, walk: Path):
    path = tmp_path / "imu.csv"
    rows = [row.split(",") for row in imu_lines(walk)]
    path.write_text("".join(",".join([str(float(r[0]) - 3.2e7), *r[1:]]) for r in rows))
    with pytest.raises(ConfigError, match="GPS time in seconds since the Unix epoch"):
        read_rinex(walk / "walk_ex.obs", walk / "walk_ex.nav", path)


def test_an_imu_file_without_a_sample_is_refused(tmp_path: Path, walk: Path):
    path = tmp_path / "imu.csv"
    path.write_text("time,ax,ay,az,gx,gy,gz\n")
    with pytest.raises(ConfigError, match="has no sample"):
        read_rinex(walk / "walk_ex.obs", walk / "walk_ex.nav", path)
