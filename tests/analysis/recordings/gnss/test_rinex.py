"""RINEX 2, 3 and 4, plain and packed, and the snapshot solution on real data."""

import gzip
from pathlib import Path

import hatanaka
import numpy as np
import pytest

from analysis.orbits.broadcast import pack_ephemeris
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.rinex_observations import read_observations
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.samples.sample import EphemerisSample, Epoch, ImuSample, IonosphereSample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.gps_clock import gps_time
from tests.analysis.orbits.snapshot_solution import solve_position

STATIC_TRUTH_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])

RINEX_2 = """\
     2.11           OBSERVATION DATA    G (GPS)             RINEX VERSION / TYPE
     7    L1    L2    C1    P2    P1    D1    S1            # / TYPES OF OBSERV
                                                            END OF HEADER
 05  3 24 13 10 36.0000000  0  3G12G 9G06
                                  23629347.915
     -1200.500          45.000
                                  20891534.648

                                  20607600.189

"""


def test_the_gps_week_of_a_known_day():
    assert gps_time(2021, 3, 19, 43200.0) == (2149, 475200.0)


def test_rinex_2_with_short_lines_and_blank_digits(tmp_path: Path):
    path = tmp_path / "a.05o"
    path.write_text(RINEX_2)
    (epoch,) = read_observations(path)
    assert epoch.satellites == ("G12", "G09", "G06")
    assert epoch.pseudorange_m.tolist() == [23629347.915, 20891534.648, 20607600.189]
    assert epoch.doppler_mps[0] == pytest.approx(1200.5 * 0.190293673)
    assert epoch.cn0_dbhz[0] == 45.0
    assert np.isnan(epoch.cn0_dbhz[1])


@pytest.mark.parametrize("suffix", ["05d", "05d.gz"])
def test_hatanaka_compressed_rinex_2_is_read(tmp_path: Path, suffix: str):
    plain = tmp_path / "a.05o"
    plain.write_text(RINEX_2)
    packed = hatanaka.rnx2crx(RINEX_2.encode())
    path = tmp_path / f"b.{suffix}"
    path.write_bytes(gzip.compress(packed) if suffix.endswith("gz") else packed)
    (one,), (other,) = read_observations(plain), read_observations(path)
    assert other.satellites == one.satellites
    assert other.pseudorange_m.tolist() == one.pseudorange_m.tolist()


def first_epochs(data: Path, count: int) -> str:
    """The beginning of a real RINEX 3 file."""
    text = (data / "gnss_imu_walk/walk_ex.obs").read_text().splitlines(keepends=True)
    start = [i for i, line in enumerate(text) if line.startswith(">")]
    return "".join(text[: start[count]])


def test_hatanaka_compressed_rinex_3_is_read(tmp_path: Path, shared_data: Path):
    text = first_epochs(shared_data, 20)
    plain, packed = tmp_path / "a.rnx", tmp_path / "a.crx"
    plain.write_text(text)
    packed.write_bytes(hatanaka.rnx2crx(text.encode()))
    for one, other in zip(read_observations(plain), read_observations(packed), strict=True):
        assert (one.t_us, one.satellites) == (other.t_us, other.satellites)
        assert np.array_equal(one.pseudorange_m, other.pseudorange_m)
        assert np.array_equal(one.doppler_mps, other.doppler_mps, equal_nan=True)


def test_observations_of_rinex_4_are_read_like_those_of_3(tmp_path: Path, shared_data: Path):
    text = first_epochs(shared_data, 5)
    three, four = tmp_path / "a.rnx", tmp_path / "b.rnx"
    three.write_text(text)
    four.write_text(text.replace("     3.04 ", "     4.01 ", 1))
    found = [[(e.t_us, e.satellites) for e in read_observations(path)] for path in (three, four)]
    assert found[0] == found[1]


def rinex_4(text: str) -> str:
    """A RINEX 3.04 navigation file as RINEX 4 has it: a line before each record, the ionosphere's
    coefficients in a record of their own, and records of messages that RINEX 3 does not know."""
    head, body = text.split("END OF HEADER       \n")
    lines = [line for line in head.splitlines() if "IONOSPHERIC CORR" not in line]
    lines[0] = lines[0].replace("3.04", "4.01", 1)
    lines += [
        " " * 60 + "END OF HEADER",
        "> ION G01 LNAV",
        "    2021 03 19 12 00 00 1.118000000000E-08 7.451000000000E-09-5.960000000000E-08",
        "    -5.960000000000E-08 9.011000000000E+04 0.000000000000E+00-1.966000000000E+05",
        "    -6.554000000000E+04 0.000000000000E+00",
        "> ION E01 IFNV",
        "    2021 03 19 12 00 00 4.550000000000E+01 5.859000000000E-02 2.228000000000E-03",
        "     0.000000000000E+00",
    ]
    record: list[str] = []
    for line in [*body.splitlines(), "X"]:
        if line[:1] != " " and record:
            kind = {"G": "LNAV", "E": "INAV"}.get(record[0][0], "FDMA")
            lines += [f"> EPH {record[0][:3]} {kind}", *record]
            if kind == "LNAV":  # CNAV's record begins like LNAV's and goes on otherwise
                lines += [f"> EPH {record[0][:3]} CNAV", *record, record[-1]]
            record = []
        record.append(line)
    return "\n".join(lines) + "\n"


def test_navigation_data_of_rinex_4_equal_those_of_rinex_3(tmp_path: Path, shared_data: Path):
    three = shared_data / "gnss_static/SEPT078M.21P"
    four = tmp_path / "a.rnx"
    four.write_text(rinex_4(three.read_text()))
    one, other = read_navigation(three), read_navigation(four)
    assert len(other) > 50
    assert [s for s in other if isinstance(s, EphemerisSample)] == [
        s for s in one if isinstance(s, EphemerisSample)
    ]
    assert [s for s in other if isinstance(s, IonosphereSample)] == [
        s for s in one if isinstance(s, IonosphereSample)
    ]


def test_a_truncated_file_ends_with_its_last_complete_epoch(tmp_path: Path, shared_data: Path):
    text = (shared_data / "gnss_static/SEPT078M.21O").read_text().splitlines(keepends=True)
    start = [i for i, line in enumerate(text) if line.startswith(">")]
    path = tmp_path / "cut.21O"
    path.write_text("".join(text[: start[3] + 5]))
    assert len(read_observations(path)) == 3


def test_a_file_that_is_not_rinex_is_refused(tmp_path: Path):
    path = tmp_path / "x.txt"
    path.write_text("hello\n")
    with pytest.raises(ConfigError, match="is not a RINEX file"):
        read_observations(path)
    with pytest.raises(ConfigError, match="No such file"):
        read_navigation(tmp_path / "absent.nav")


def test_a_real_static_file_gives_its_position(shared_data: Path):
    samples = read_rinex_samples(
        shared_data / "gnss_static/SEPT078M.21O", shared_data / "gnss_static/SEPT078M.21P"
    )
    ionosphere = next(s for s in samples if isinstance(s, IonosphereSample))
    assert ionosphere.alpha[0] == 0.1118e-7
    packed = {}
    for sample in samples:
        if isinstance(sample, EphemerisSample) and abs(sample.ephemeris.toe_s - 475200) <= 7200:
            packed[sample.ephemeris.satellite] = pack_ephemeris(sample.ephemeris)
    epoch = next(s for s in samples if isinstance(s, Epoch))
    keep = [i for i, name in enumerate(epoch.satellites) if name in packed]
    names = tuple(epoch.satellites[i] for i in keep)
    part = Epoch(
        epoch.t_us,
        epoch.week,
        epoch.tow_s,
        names,
        epoch.pseudorange_m[keep],
        epoch.doppler_mps[keep],
        epoch.cn0_dbhz[keep],
    )
    fix = solve_position(
        part,
        np.array([packed[n] for n in names]),
        np.array(ionosphere.alpha + ionosphere.beta),
        np.ones(len(names)),
    )
    assert fix is not None
    assert np.linalg.norm(fix.r_ecef_m - STATIC_TRUTH_M) < 4.0  # a code solution's bias
    assert len(names) >= 18


def test_imu_samples_come_in_order_and_in_body_axes(shared_data: Path):
    folder = shared_data / "gnss_imu_walk"
    samples = read_rinex_samples(
        folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    )
    imu = [s for s in samples if isinstance(s, ImuSample)]
    assert len(imu) == 20455
    assert np.mean([s.accel_b_mps2[2] for s in imu[:200]]) == pytest.approx(-9.9, abs=0.2)
    stamps = [s.t_us for s in samples if isinstance(s, ImuSample | Epoch)]
    assert stamps == sorted(stamps)
