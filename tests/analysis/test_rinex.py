"""RINEX 2 and 3 observations and navigation, and the snapshot solution on real data."""

from pathlib import Path

import numpy as np
import pytest

from analysis.epochs import read_rinex_samples
from analysis.gnss import pack_ephemeris
from analysis.rinex import gps_time, read_observations
from analysis.rinex_navigation import read_navigation
from analysis.samples import EphemerisSample, Epoch, ImuSample, IonosphereSample
from analysis.solve import solve
from mavproxy_fault.errors import ConfigError

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


def test_a_file_cut_inside_an_epoch_ends_with_the_last_whole_one(tmp_path: Path, shared_data: Path):
    text = (shared_data / "gnss_static/SEPT078M.21O").read_text().splitlines(keepends=True)
    start = [i for i, line in enumerate(text) if line.startswith(">")]
    path = tmp_path / "cut.21O"
    path.write_text("".join(text[: start[3] + 5]))
    assert len(read_observations(path)) == 3


def test_what_is_no_rinex_is_refused(tmp_path: Path):
    path = tmp_path / "x.txt"
    path.write_text("hello\n")
    with pytest.raises(ConfigError, match="is not a RINEX file"):
        read_observations(path)
    with pytest.raises(ConfigError, match="cannot be read"):
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
    fix = solve(
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
