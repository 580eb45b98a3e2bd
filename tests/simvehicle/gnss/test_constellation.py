"""The sky over a home, and which ephemerides are valid when."""

import math
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.rtcm.ephemeris_messages import decode_ephemeris, encode_ephemeris
from simvehicle.gnss.constellation import (
    SHIPPED,
    Constellation,
    build_constellation,
    read_navigation,
)
from simvehicle.gnss.gnss_config import GnssConfig, ReceiverConfig
from simvehicle.gnss.pseudorange import NO_COEFFICIENTS, SAT_ELEVATION, Atmosphere, signal_geometry
from simvehicle.gnss.satellite_orbits import Orbits, tabulate_orbits

PLACES = [(47.4, 8.5), (-35.4, 149.2), (40.2, -111.7), (0.0, 0.0), (-33.0, -70.0), (60.0, 179.9)]


def signals_at(
    orbits: Orbits, tow_s: float, r_m: np.ndarray, v_mps: np.ndarray, air: Atmosphere
) -> np.ndarray:
    """The signals at a place, as rows."""
    return signal_geometry(orbits.table, tow_s, r_m, v_mps, air.coefficients, air.troposphere)


def elevations(constellation: Constellation, lat_deg: float, lon_deg: float, at_s: float) -> dict:
    chosen = constellation.choose_ephemerides(constellation.start_s + at_s, [None] * 24)
    sets = [e[k] for e, k in zip(constellation.ephemerides, chosen, strict=True) if k is not None]
    place = ecef_from_geodetic(math.radians(lat_deg), math.radians(lon_deg), 100.0)
    seen = signals_at(
        tabulate_orbits(sets, constellation.week),
        constellation.start_s + at_s,
        place,
        np.zeros(3),
        Atmosphere(NO_COEFFICIENTS, False),
    )
    return dict(zip([e.satellite for e in sets], np.degrees(seen[SAT_ELEVATION]), strict=True))


@pytest.mark.parametrize(("lat_deg", "lon_deg"), PLACES)
@pytest.mark.parametrize("at_s", [0.0, 1800.0, 3600.0])
def test_the_shipped_sky_has_enough_satellites_over_any_home_for_an_hour(
    lat_deg: float, lon_deg: float, at_s: float
) -> None:
    constellation = build_constellation(GnssConfig(), math.radians(lat_deg), math.radians(lon_deg))
    up = [n for n, el in elevations(constellation, lat_deg, lon_deg, at_s).items() if el > 10.0]
    assert sum(n[0] == "G" for n in up) >= 6
    assert len(up) >= 12


def test_every_satellite_of_the_shipped_sky_is_valid_for_an_hour() -> None:
    constellation = build_constellation(GnssConfig(), 0.6, 2.4)
    chosen: tuple[int | None, ...] = (None,) * 24
    for at_s in range(0, 3601, 60):
        chosen = constellation.choose_ephemerides(constellation.start_s + at_s, chosen)
        for sets, k in zip(constellation.ephemerides, chosen, strict=True):
            assert k is not None
            assert abs(constellation.start_s + at_s - sets[k].toe_s) <= sets[k].fit_half_s


def test_at_the_site_of_the_file_nothing_is_rotated() -> None:
    real = read_navigation(SHIPPED)[0]
    near = build_constellation(GnssConfig(), math.radians(35.3), math.radians(139.5))
    assert dict(zip(near.satellites, near.ephemerides, strict=True)) == real


def test_a_rotated_sky_is_the_same_sky_and_matches_its_messages() -> None:
    there = build_constellation(GnssConfig(), math.radians(35.339), math.radians(139.522))
    here = build_constellation(GnssConfig(), math.radians(-35.339), math.radians(-50.478))
    north = elevations(there, 35.339, 139.522, 0.0)
    south = elevations(here, -35.339, -50.478, 0.0)
    assert north == pytest.approx(south, abs=0.2)
    for sets in here.ephemerides:
        for e in sets:
            assert decode_ephemeris(encode_ephemeris(e)) == e


def test_an_ephemeris_is_kept_while_valid_and_then_replaced() -> None:
    constellation = build_constellation(GnssConfig(), 0.6, 2.4)
    at = constellation.satellites.index("G03")  # 12:00 and 14:00, each two hours either way
    present: tuple[int | None, ...] = (None,) * 24
    seen = []
    for hours in (0.0, 1.9, 2.0, 2.1, 3.9, 4.1):
        present = constellation.choose_ephemerides(constellation.start_s + hours * 3600.0, present)
        seen.append(present[at])
    assert seen == [0, 0, 0, 1, 1, None]


def test_a_choice_is_valid_until_an_ephemeris_ends_or_another_satellite_gets_one() -> None:
    constellation = build_constellation(GnssConfig(), 0.6, 2.4)
    start_s = constellation.start_s
    chosen = constellation.choose_ephemerides(start_s, [None] * 24)
    used = [e[k] for e, k in zip(constellation.ephemerides, chosen, strict=True) if k is not None]
    ends = [e.toe_s + e.fit_half_s for e in used]
    assert constellation.valid_until_s(start_s, chosen) == min(ends)
    early_s = start_s - 3.0 * 3600.0  # before G02, whose only ephemeris is that of 14:00
    before = constellation.choose_ephemerides(early_s, [None] * 24)
    assert before[constellation.satellites.index("G02")] is None
    assert constellation.valid_until_s(early_s, before) <= start_s
    late_s = start_s + 5.0 * 3600.0
    gone = constellation.choose_ephemerides(late_s, [None] * 24)
    assert constellation.valid_until_s(late_s, gone) == math.inf


def test_systems_not_configured_are_left_out() -> None:
    gps = build_constellation(GnssConfig(systems=("GPS",)), 0.6, 2.4)
    assert {name[0] for name in gps.satellites} == {"G"}


def test_another_file_starts_where_most_of_its_satellites_are_valid(tmp_path: Path) -> None:
    (tmp_path / "own.nav").write_text(SHIPPED.read_text())
    own = build_constellation(GnssConfig(navigation=str(tmp_path / "own.nav")), 0.0, 0.0)
    assert own.week == 2149
    assert all(k is not None for k in own.choose_ephemerides(own.start_s, [None] * 24))
    assert own.ephemerides == tuple(read_navigation(SHIPPED)[0].values())


def test_a_start_at_which_nothing_is_valid_is_refused() -> None:
    with pytest.raises(ConfigError, match="no satellite of GPS and Galileo is valid at GPS week"):
        build_constellation(GnssConfig(time=datetime(2021, 3, 19, 23)), 0.6, 2.4)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"systems": ()}, "systems is empty"),
        ({"rate_hz": 0.0}, "> 0.*rate_hz"),
        ({"rate_hz": 1e9}, "<= 100.*rate_hz"),
        ({"mask_deg": 91.0}, "<= 90.*mask_deg"),
        ({"latency_s": -1.0}, ">= 0.*latency_s"),
    ],
)
def test_invalid_receiver_parameters_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        msgspec.convert(wrong, GnssConfig)


@pytest.mark.parametrize("span", [(36.0, 18.0), (-1.0, 5.0), (0.0, math.inf)])
def test_an_invalid_range_of_message_times_is_refused(span: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="is not a range"):
        ReceiverConfig(message_s=span)


def test_times_of_another_week_are_weeks_away() -> None:
    constellation = build_constellation(GnssConfig(), 0.6, 2.4)
    wrong = replace(constellation, week=2150)
    assert set(wrong.choose_ephemerides(constellation.start_s, [None] * 24)) == {None}
