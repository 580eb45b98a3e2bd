"""Orbits of GLONASS and BeiDou against RTKLIB and real pseudoranges."""

from datetime import date
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.orbits.broadcast import (
    B1I_HZ,
    TYPICAL_ALPHA,
    TYPICAL_BETA,
    pack_ephemeris,
    packed_for,
    satellite_states,
)
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.rinex_observations import read_observations
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import EphemerisSample, Epoch, Orbit
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.gps_clock import leap_seconds
from tests.analysis.orbits.snapshot_solution import Fix, solve_position

AUTHORITY = Path(__file__).parents[2] / "authorities/rtklib_states"
NUMBERS = {"39": "R07", "106": "C01", "126": "C21"}


def orbits() -> dict[str, Orbit]:
    found = [s for s in read_navigation(AUTHORITY / "orbits.nav") if isinstance(s, EphemerisSample)]
    return {s.ephemeris.satellite: s.ephemeris for s in found}


def packed() -> dict[str, np.ndarray]:
    return {name: pack_ephemeris(orbit) for name, orbit in orbits().items()}


def by_rtklib() -> list[tuple[str, np.ndarray, float]]:
    """Satellite, position (3,) in m and clock in m, in the order of the epochs."""
    out = []
    for line in (AUTHORITY / "states.txt").read_text().splitlines():
        name = NUMBERS[line.split("sat=")[1].split()[0]]
        r = [float(x) for x in line.split("rs=")[1].split("dts=")[0].split()]
        clock_ns = float(line.split("dts=")[1].split()[0])
        out.append((name, np.array(r), clock_ns * 1e-9 * SPEED_OF_LIGHT_MPS))
    return out


def states(epoch: Epoch, later_s: float = 0.0) -> dict[str, np.ndarray]:
    rows = packed()
    table = np.array([rows[name] for name in epoch.satellites])
    found = satellite_states(table, epoch.week, epoch.tow_s + later_s, epoch.pseudorange_m)
    return dict(zip(epoch.satellites, found, strict=True))


def test_orbits_and_clocks_are_those_of_rtklib():
    expected, rows = by_rtklib(), packed()
    for epoch in read_observations(AUTHORITY / "times.obs"):
        found = states(epoch)
        for name, r, clock_m in expected[:3]:
            assert found[name][:3] == pytest.approx(r, abs=0.01), name
            with_delay_m = found[name][6] + SPEED_OF_LIGHT_MPS * rows[name][22]
            assert with_delay_m == pytest.approx(clock_m, abs=0.01), name
        expected = expected[3:]
    assert not expected


def test_velocities_are_the_positions_rates_of_change():
    epoch = read_observations(AUTHORITY / "times.obs")[2]
    before, now, after = (states(epoch, dt) for dt in (-0.5, 0.0, 0.5))
    for name in epoch.satellites:
        assert now[name][3:6] == pytest.approx(after[name][:3] - before[name][:3], abs=1e-3), name


def test_utc_is_behind_gps_time_by_the_leap_seconds():
    days = date(1980, 1, 6), date(2005, 12, 31), date(2006, 1, 1), date(2021, 3, 19)
    assert [leap_seconds(day) for day in days] == [0, 13, 14, 18]


def test_another_carrier_has_its_own_ionosphere_and_b3i_no_group_delay():
    orbit, row = orbits()["C21"], packed()["C21"]
    b1i, b3i = (packed_for(row, orbit, hz, None) for hz in (B1I_HZ, 1268.52e6))
    assert (b1i[22], b3i[22]) == (row[22], 0.0)
    assert (row[24], b1i[24]) == (1.0, pytest.approx(1.0184, abs=1e-4))
    assert b3i[24] == pytest.approx(1.5424, abs=1e-4)


GLONASS_OBS = """\
     3.04           OBSERVATION DATA    M                   RINEX VERSION / TYPE
R    3 C1C D1C S1C                                          SYS / # / OBS TYPES
 12 R01  1 R02 -4 R03  5 R04  6 R05  1 R06 -4 R07  5 R08  6 GLONASS SLOT / FRQ #
    R09 -2 R10 -7 R11  0 R12 -1                             GLONASS SLOT / FRQ #
                                                            END OF HEADER
> 2021 03 19 11 35  0.0000000  0  2
R10  21500000.000        1000.000          45.000
R13  21600000.000        1000.000          45.000
"""


def test_a_glonass_rate_needs_its_channel(tmp_path: Path):
    path = tmp_path / "a.obs"
    path.write_text(GLONASS_OBS)
    (epoch,) = read_observations(path)
    assert epoch.carrier_hz is not None
    assert epoch.carrier_hz.tolist() == [1602e6 - 7 * 0.5625e6, 1602e6]
    assert epoch.doppler_mps[0] == pytest.approx(-1000.0 * SPEED_OF_LIGHT_MPS / 1598.0625e6)
    assert np.isnan(epoch.doppler_mps[1])


def walk(data: Path, count: int) -> list:
    """The first epochs of the walk, and its ephemerides."""
    folder = data / "gnss_imu_walk"
    samples = read_rinex_samples(folder / "walk_ex.obs", folder / "walk_ex.nav")
    last = [i for i, s in enumerate(samples) if isinstance(s, Epoch)][count]
    return samples[:last]


def fix_of(samples: list, systems: str) -> Fix:
    """The snapshot solution of the first epoch with the satellites of some systems."""
    known = {s.ephemeris.satellite: s.ephemeris for s in samples if isinstance(s, EphemerisSample)}
    epoch = next(s for s in samples if isinstance(s, Epoch))
    names = epoch.satellites
    epoch = epoch.select([i for i, n in enumerate(names) if n in known and n[0] in systems])
    assert epoch.carrier_hz is not None
    rows = [
        packed_for(pack_ephemeris(known[name]), known[name], hz, None)
        for name, hz in zip(epoch.satellites, epoch.carrier_hz.tolist(), strict=True)
    ]
    ionosphere = np.array(TYPICAL_ALPHA + TYPICAL_BETA)
    fix = solve_position(epoch, np.array(rows), ionosphere, np.ones(len(rows)))
    assert fix is not None
    return fix


def test_beidou_alone_gives_the_position_of_gps_and_galileo(shared_data: Path):
    samples = walk(shared_data, 5)
    alone, others = fix_of(samples, "C"), fix_of(samples, "GE")
    assert alone.dof >= 3
    assert np.linalg.norm(alone.r_ecef_m - others.r_ecef_m) < 10.0  # metres of multipath each
    assert np.sqrt(alone.statistic / alone.dof) < 4.0  # m


def test_beidou_is_used_with_its_own_clock_offset(shared_data: Path):
    config = DetectorConfig(systems="GC")
    found = run_detector(Detector(config), walk(shared_data, 40))
    decisions = [d for d in found if isinstance(d, Decision)]
    assert {name[0] for name in decisions[-1].satellites} == {"G", "C"}
    assert not any(d.alarm for d in decisions)
    satellites = len(decisions[-1].satellites)
    assert decisions[-1].parity_dof == satellites - 5


def test_unknown_systems_are_refused():
    with pytest.raises(ValueError, match="give letters of GERCJ"):
        DetectorConfig(systems="GX")
