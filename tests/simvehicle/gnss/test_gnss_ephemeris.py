"""Satellite positions against precise orbits, and velocities against differences."""

from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.gps_clock import time_of_words
from simvehicle.gnss.constellation import SHIPPED, read_navigation
from simvehicle.gnss.satellite_orbits import select_orbits, tabulate_orbits
from tests.simvehicle.gnss.gnss_parts import satellite_states

PRECISE = Path(__file__).parents[2] / "authorities" / "code_orbits" / "orbits.sp3"
EPHEMERIDES, KLOBUCHAR = read_navigation(SHIPPED)


def precise() -> list[tuple[str, float, np.ndarray, float]]:
    """Satellite, seconds of week, position [m] and clock [s] of each record."""
    rows = []
    tow_s = 0.0
    for line in PRECISE.read_text().splitlines():
        if line[0] == "*":
            tow_s = time_of_words([*line.split()[1:6], "0"], "GPS")[1]
        else:
            x, y, z, clock = (float(v) for v in line[4:].split())
            rows.append((line[1:4], tow_s, np.array([x, y, z]) * 1e3, clock * 1e-6))
    return rows


@pytest.mark.parametrize("row", precise(), ids=lambda row: f"{row[0]}-{row[1]:.0f}")
def test_broadcast_orbits_and_clocks_agree_with_precise_ones(
    row: tuple[str, float, np.ndarray, float],
) -> None:
    name, tow_s, position, clock_s = row
    ephemeris = min(EPHEMERIDES[name], key=lambda e: abs(e.toe_s - tow_s))
    r, v, clock, _ = satellite_states(tabulate_orbits([ephemeris], 2149), np.array([tow_s]))
    assert np.linalg.norm(r[0] - position) < 2.5  # broadcast: 1 m, and the antenna's offset
    inertial = v[0] + np.cross([0.0, 0.0, GNSS_EARTH_RATE_RPS], r[0])
    relativity_s = -2.0 * (r[0] @ inertial) / SPEED_OF_LIGHT_MPS**2  # IS-GPS-200N 20.3.3.3.3.1
    polynomial_s = clock[0] + ephemeris.group_delay_s - relativity_s
    assert polynomial_s == pytest.approx(clock_s, abs=5e-9)


def test_velocities_and_clock_rates_are_the_derivatives() -> None:
    orbits = tabulate_orbits([sets[0] for sets in EPHEMERIDES.values()], 2149)
    t = np.full(len(orbits.table), 476000.0)
    r, v, _, clock_rate = satellite_states(orbits, t)
    ahead, behind = satellite_states(orbits, t + 0.5), satellite_states(orbits, t - 0.5)
    assert np.abs(ahead[0] - behind[0] - v).max() < 1e-4
    assert np.abs(ahead[2] - behind[2] - clock_rate).max() < 1e-15
    assert np.linalg.norm(r, axis=1).min() > 2.5e7


def test_another_week_shifts_the_times_and_nothing_else() -> None:
    sets = [EPHEMERIDES["G17"][0], EPHEMERIDES["E08"][0]]
    tow = np.array([475300.0, 475300.0])
    here = satellite_states(tabulate_orbits(sets, 2149), tow)
    there = satellite_states(tabulate_orbits(sets, 2148), tow + 604800.0)
    for a, b in zip(here, there, strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-14)


def test_selected_rows_are_the_orbits_of_the_selected_satellites() -> None:
    every = tabulate_orbits([sets[0] for sets in EPHEMERIDES.values()], 2149)
    some = select_orbits(every, np.array([3, 1]))
    assert some.satellites == (every.satellites[3], every.satellites[1])
    assert np.array_equal(some.table, every.table[[3, 1]])
