"""Precise orbits and clocks: read, interpolated, and a judge of broadcast ephemerides."""

import gzip
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from analysis.detection.filter.ephemerides import BroadcastData, select_ephemerides
from analysis.detection.stages.ephemeris_fault import with_orbits_compared
from analysis.orbits.broadcast import CLOCK, pack_ephemeris, satellite_states
from analysis.recordings.gnss.precise_files import precise_samples, read_precise
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.results import Decision
from analysis.samples.sample import EphemerisSample, Epoch, PreciseOrbit, Vector
from analysis.scoring.alarm_windows import alarms_of
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

SHIPPED = Path(__file__).parents[4] / "simvehicle" / "gnss" / "constellation.nav"
NOON = datetime(2021, 3, 19, 12, tzinfo=UTC)
WEEK, NOON_S = 2149, 5 * 86_400 + 43_200.0


def known() -> dict[str, Ephemeris]:
    """The ephemeris of noon of each satellite of the shipped constellation."""
    found: dict[str, Ephemeris] = {}
    for sample in read_navigation(SHIPPED):
        if isinstance(sample, EphemerisSample) and isinstance(sample.ephemeris, Ephemeris):
            e = sample.ephemeris
            if e.satellite not in found or abs(e.toe_s - NOON_S) < abs(
                found[e.satellite].toe_s - NOON_S
            ):
                found[e.satellite] = e
    return found


def state(ephemeris: Ephemeris | PreciseOrbit, at_s: float) -> Vector:
    """A satellite (9,) at a time that does not depend on its clock."""
    packed = pack_ephemeris(ephemeris)
    offset_s = satellite_states(packed[None], WEEK, NOON_S + at_s, np.zeros(1))[0, CLOCK]
    later_s = NOON_S + at_s + offset_s / SPEED_OF_LIGHT_MPS
    found: Vector = satellite_states(packed[None], WEEK, later_s, np.zeros(1))[0]
    return found


def write_precise(folder: Path, minutes: int = 5) -> tuple[Path, Path]:
    """SP3 and CLK files of the ephemerides of noon, two hours before to two hours after it."""
    heads = {"sp3": "#dP2021  3 19 10  0  0.00000000      49 ORBIT IGb14 FIT TEST\n"}
    heads["sp3"] += "%c M  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc\n"
    orbits, clocks = heads["sp3"], f"{3.0:9.2f}{'':11}C{'':39}RINEX VERSION / TYPE\n"
    clocks += f"{'':60}END OF HEADER\n"
    for at_s in range(-7200, 7201, 60 * minutes):
        day = NOON + timedelta(seconds=at_s)
        date = f"{day.year} {day.month:2d} {day.day:2d} {day.hour:2d} {day.minute:2d}  0.00000000"
        orbits += f"*  {date}\n"
        for name, e in known().items():
            seen = state(replace(e, group_delay_s=0.0), at_s)
            relativity_s = -2.0 * seen[:3] @ seen[3:6] / SPEED_OF_LIGHT_MPS**2
            offset_s = seen[CLOCK] / SPEED_OF_LIGHT_MPS - relativity_s
            x, y, z = seen[:3] / 1e3
            orbits += f"P{name}{x:14.6f}{y:14.6f}{z:14.6f}{999999.999999:14.6f}\n"
            clocks += f"AS {name}  {date.replace('.00000000', '.000000')}  1   {offset_s:19.12e}\n"
    paths = folder / "a.sp3.gz", folder / "a.clk"
    paths[0].write_bytes(gzip.compress((orbits + "EOF\n").encode()))
    paths[1].write_text(clocks)
    return paths


@pytest.fixture(scope="module")
def precise(tmp_path_factory: pytest.TempPathFactory) -> list[EphemerisSample]:
    paths = write_precise(tmp_path_factory.mktemp("precise"))
    begin_s = WEEK * 604_800 + NOON_S
    return precise_samples(read_precise(paths), list(known().values()), begin_s, begin_s + 600.0)


def test_between_the_values_of_a_table_orbit_and_clock_are_those_of_its_satellite(precise):
    broadcast = known()
    names = {s.ephemeris.satellite for s in precise}
    assert names == broadcast.keys()
    for sample in precise:
        orbit = sample.ephemeris
        assert isinstance(orbit, PreciseOrbit)
        own = broadcast[orbit.satellite]
        # Galileo's precise clocks are of E1 and E5a.
        delay_s = own.group_delay_e5a_s or own.group_delay_s
        own = replace(own, group_delay_s=delay_s)
        for since_s in (-140.0, 0.0, 33.0, 200.0):
            at_s = orbit.toe_s - NOON_S + since_s
            ours, theirs = state(orbit, at_s), state(own, at_s)
            assert ours[:3] == pytest.approx(theirs[:3], abs=0.02)
            assert ours[3:6] == pytest.approx(theirs[3:6], abs=5e-4)
            assert ours[CLOCK] == pytest.approx(theirs[CLOCK], abs=0.02)


def select(precise: list[EphemerisSample], wrong: Ephemeris | None, of: str = "GE"):
    data = BroadcastData({}, np.zeros(9))
    for sample in precise:
        data = data.add_ephemeris(sample.ephemeris)
    for name, ephemeris in known().items():
        own = wrong if wrong is not None and wrong.satellite == name else ephemeris
        data = data.add_ephemeris(own)
    names = tuple(name for name in sorted(known()) if name[0] in of or name < "E08")
    ranges = np.full(len(names), 2.2e7)
    epoch = Epoch(0, WEEK, NOON_S + 120.0, names, ranges, ranges * 0.0, ranges * 0.0 + 45.0)
    return select_ephemerides(epoch, data.ephemerides)


def test_precise_orbits_are_used_first_and_agree_with_sound_ephemerides(precise):
    found = select(precise, None)
    assert all(isinstance(orbit, PreciseOrbit) for orbit in found.used)
    assert found.contradicted == frozenset()
    assert set(found.differences_m) == set(known())
    # Less the group delays of another pair of signals, Galileo's differ by nothing.
    assert max(abs(off_m) for off_m in found.differences_m.values()) < 1.5


def test_the_clocks_of_few_satellites_are_not_compared(precise):
    found = select(precise, None, of="G")
    assert sum(name[0] == "E" for name in found.names) == 4
    assert {name[0] for name in found.differences_m} == {"G"}


@pytest.mark.parametrize(
    ("changes", "metres"), [({"af0_s": 50.0 / SPEED_OF_LIGHT_MPS}, 50.0), ({"m0_rad": 1e-5}, 64.0)]
)
def test_an_ephemeris_far_from_its_precise_orbit_is_named_and_another_satellite_is_not(
    precise, changes, metres
):
    own = known()["G28"]
    changed = {name: getattr(own, name) + by for name, by in changes.items()}
    wrong = replace(own, **changed)
    found = select(precise, wrong)
    assert found.contradicted == {wrong}
    assert abs(found.differences_m["G28"]) == pytest.approx(metres, rel=0.1)
    decision = with_orbits_compared(Decision(t_us=0, hypothesis="none"), found)
    assert (decision.hypothesis, decision.alarm) == ("ephemeris", True)
    assert decision.reason.startswith("ephemeris of G28 of 12:00 is wrong: ")
    assert decision.orbit_difference_m == found.differences_m


def test_a_wrong_ephemeris_leaves_what_the_epoch_isolates_beside_it(precise):
    own = known()["G28"]
    found = select(precise, replace(own, af0_s=own.af0_s + 50.0 / SPEED_OF_LIGHT_MPS))
    isolated = Decision(t_us=0, hypothesis="imu", alarm=True, reason="the IMU is silent")
    decision = with_orbits_compared(isolated, found)
    (wrong,) = decision.wrong_ephemerides
    assert (decision.hypothesis, decision.reason) == ("imu", f"the IMU is silent; {wrong}")
    assert {(alarm.name, alarm.isolated) for alarm in alarms_of(decision)} == {
        ("imu", True),
        ("ephemeris", False),
    }


def test_a_satellite_is_left_to_its_ephemeris_where_the_tables_end(tmp_path):
    tables = read_precise(write_precise(tmp_path, minutes=15))
    end_s = WEEK * 604_800 + NOON_S + 7200.0
    found = precise_samples(tables, list(known().values()), end_s - 300.0, end_s + 3600.0)
    assert {s.ephemeris.toe_s - NOON_S for s in found} == {6900.0, 7200.0}
    assert not precise_samples(tables, [], end_s - 300.0, end_s)


def test_the_first_versions_have_numbers_for_names_and_unknown_clocks(tmp_path):
    line = "P  1  12000.000000 -13000.000000  21000.000000 999999.999999\n"
    head = (
        "# a1995 12  1  0  0   .0000000      96 1UN   ITR92 FIT\n*  1995 12  1  0  0   .0000000\n"
    )
    (tmp_path / "a.sp3").write_text(head + line + line.replace("P  1", "P 31"))
    orbits, clocks = read_precise([tmp_path / "a.sp3"])
    assert list(orbits) == ["G01", "G31"]
    assert clocks == {}


def test_a_cut_file_is_refused_in_one_line(tmp_path):
    path = write_precise(tmp_path)[0]
    text = gzip.decompress(path.read_bytes()).decode()
    (tmp_path / "cut.sp3").write_text(text[: text.index("PG02") + 20])
    with pytest.raises(ConfigError, match=r"cut\.sp3: is damaged"):
        read_precise([tmp_path / "cut.sp3"])
    (tmp_path / "cut.gz").write_bytes(path.read_bytes()[:100])
    with pytest.raises(ConfigError, match="cannot be decompressed"):
        read_precise([tmp_path / "cut.gz"])


def test_two_days_of_precise_orbits_are_kept_from_their_first_epoch_on(precise):
    first = next(s.ephemeris for s in precise if s.ephemeris.satellite == "G28")
    data = BroadcastData({}, np.zeros(9))
    for node in range(2 * 288):
        data = data.add_ephemeris(replace(first, toe_s=300.0 * node))
    names, one = ("G28",), np.ones(1)
    epoch = Epoch(0, WEEK, 0.0, names, 2.2e7 * one, 0.0 * one, 45.0 * one)
    used = select_ephemerides(epoch, data.ephemerides).used
    assert [orbit.toe_s for orbit in used] == [0.0]
