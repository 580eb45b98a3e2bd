"""Geometry against the light-time equation, and everything against a real receiver."""

import math
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth import ecef_from_geodetic, geodetic_from_ecef
from simvehicle.gnss.constellation import SHIPPED, read_navigation
from simvehicle.gnss.pseudorange import (
    DELAY,
    LINE_OF_SIGHT,
    NO_COEFFICIENTS,
    RANGE,
    RANGE_RATE,
    SAT_AZIMUTH,
    SAT_CLOCK,
    SAT_ELEVATION,
    Atmosphere,
    signal_geometry,
)
from simvehicle.gnss.satellite_orbits import Orbits, tabulate_orbits
from tests.simvehicle.gnss.gnss_parts import satellite_states

VACUUM = Atmosphere(NO_COEFFICIENTS, False)
TOW_S = 475200.0
SITE_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])  # the real receiver's antenna
REST = np.zeros(3)


def signals_at(
    orbits: Orbits, tow_s: float, r_m: np.ndarray, v_mps: np.ndarray, air: Atmosphere
) -> np.ndarray:
    """The signals at a place, as rows."""
    return signal_geometry(orbits.table, tow_s, r_m, v_mps, air.coefficients, air.troposphere)


def orbits() -> Orbits:
    return tabulate_orbits([sets[0] for sets in read_navigation(SHIPPED)[0].values()], 2149)


def inertial(r_m: np.ndarray, t_s: float) -> np.ndarray:
    """Earth-fixed vectors at `t_s` in the frame that is inertial and coincides at TOW_S."""
    angle = GNSS_EARTH_RATE_RPS * (t_s - TOW_S)
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ r_m


def test_ranges_solve_the_light_time_equation_in_an_inertial_frame() -> None:
    seen = signals_at(orbits(), TOW_S, SITE_M, REST, VACUUM)
    sent_s = TOW_S - seen[RANGE] / SPEED_OF_LIGHT_MPS
    positions, _, clocks, _ = satellite_states(orbits(), sent_s)
    for k, position in enumerate(positions):
        flown = np.linalg.norm(inertial(position, float(sent_s[k])) - SITE_M)
        assert flown == pytest.approx(seen[RANGE, k], abs=2e-6)
    assert seen[SAT_CLOCK] == pytest.approx(clocks, abs=1e-16)


def test_rates_are_the_derivatives_of_ranges_for_a_moving_receiver() -> None:
    v = np.array([50.0, -120.0, 30.0])
    ahead = signals_at(orbits(), TOW_S + 0.1, SITE_M + 0.1 * v, v, VACUUM)
    behind = signals_at(orbits(), TOW_S - 0.1, SITE_M - 0.1 * v, v, VACUUM)
    seen = signals_at(orbits(), TOW_S, SITE_M, v, VACUUM)
    assert seen[RANGE_RATE] == pytest.approx((ahead[RANGE] - behind[RANGE]) / 0.2, abs=3e-5)


def test_directions_are_those_of_the_local_horizon() -> None:
    seen = signals_at(orbits(), TOW_S, SITE_M, REST, VACUUM)
    lat, lon, height = geodetic_from_ecef(SITE_M)
    for k, (elevation, azimuth) in enumerate(
        zip(seen[SAT_ELEVATION], seen[SAT_AZIMUTH], strict=True)
    ):
        step = 1e-5  # rad north and east; the range must shrink accordingly
        north = ecef_from_geodetic(lat + step, lon, height) - SITE_M
        east = ecef_from_geodetic(lat, lon + step, height) - SITE_M
        assert seen[LINE_OF_SIGHT:, k] @ north / np.linalg.norm(north) == pytest.approx(
            math.cos(elevation) * math.cos(azimuth), abs=1e-5
        )
        assert seen[LINE_OF_SIGHT:, k] @ east / np.linalg.norm(east) == pytest.approx(
            math.cos(elevation) * math.sin(azimuth), abs=1e-5
        )


def test_satellites_below_the_horizon_have_negative_elevation() -> None:
    other_side = signals_at(orbits(), TOW_S, -SITE_M, REST, VACUUM)
    assert other_side[SAT_ELEVATION].max() < 0.0
    assert np.isfinite(other_side[RANGE]).all()


def real_epochs(path: Path) -> list[tuple[float, dict[str, float]]]:
    """Seconds of week and C1C [m] by satellite of every 60th epoch."""
    epochs: list[tuple[float, dict[str, float]]] = []
    for line in path.read_text().split("END OF HEADER")[1].splitlines()[1:]:
        if line[0] == ">":
            parts = line.split()
            epochs.append((TOW_S + 60.0 * int(parts[5]) + float(parts[6]), {}))
        elif line[0] in "GE" and line[3:17].strip():
            epochs[-1][1][line[:3]] = float(line[3:17])
    return epochs[::60]


def test_a_real_receiver_at_a_known_position_agrees_with_the_models(shared_data: Path) -> None:
    ephemerides, klobuchar = read_navigation(SHIPPED)
    air = Atmosphere(np.array(klobuchar), True)
    squares: list[float] = []
    for tow_s, ranges in real_epochs(shared_data / "gnss_static" / "SEPT078M.21O"):
        names = [n for n in ranges if n in ephemerides]
        measured = np.array([ranges[n] for n in names])
        galileo = np.array([n[0] == "E" for n in names])
        table = tabulate_orbits([ephemerides[n][0] for n in names], 2149)
        offset_m = 0.0
        for _ in range(3):  # the receiver's clock follows from the ranges
            true_s = tow_s - offset_m / SPEED_OF_LIGHT_MPS
            seen = signals_at(table, true_s, SITE_M, REST, air)
            residual = measured - seen[RANGE] + SPEED_OF_LIGHT_MPS * seen[SAT_CLOCK] - seen[DELAY]
            offset_m = float(np.median(residual[~galileo]))
        residual -= np.where(galileo, np.median(residual[galileo]), offset_m)
        squares += list(residual[seen[SAT_ELEVATION] > math.radians(15.0)] ** 2)
    assert len(squares) > 200
    assert math.sqrt(np.mean(squares)) < 1.0
    assert math.sqrt(max(squares)) < 3.0
