"""The receiver's least squares: exact without errors, consistent with its sigma otherwise."""

import math

import numpy as np
import pytest

from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from simvehicle.gnss.constellation import SHIPPED, read_navigation
from simvehicle.gnss.pseudorange import (
    DELAY,
    RANGE,
    RANGE_RATE,
    SAT_CLOCK,
    SAT_CLOCK_RATE,
    SAT_ELEVATION,
    Atmosphere,
    signal_geometry,
)
from simvehicle.gnss.receiver import NO_FIX, solve_receiver_fix
from simvehicle.gnss.satellite_orbits import Orbits, select_orbits, tabulate_orbits

TOW_S = 475200.0
PLACE_M = ecef_from_geodetic(math.radians(35.3), math.radians(139.5), 300.0)
MOTION = np.array([12.0, -7.0, 3.0])
EPHEMERIDES, KLOBUCHAR = read_navigation(SHIPPED)
AIR = Atmosphere(np.array(KLOBUCHAR), True)
OFFSET_S, DRIFT = 2.5e-4, 3e-7
GALILEO_M = 4.0


def signals_at(
    orbits: Orbits, tow_s: float, r_m: np.ndarray, v_mps: np.ndarray, air: Atmosphere
) -> np.ndarray:
    """The signals at a place, as rows."""
    return signal_geometry(orbits.table, tow_s, r_m, v_mps, air.coefficients, air.troposphere)


def in_view(letters: str = "GE") -> Orbits:
    every = tabulate_orbits([sets[0] for sets in EPHEMERIDES.values()], 2149)
    seen = signals_at(every, TOW_S, PLACE_M, MOTION, AIR)
    pick = [k for k in range(24)
            if seen[SAT_ELEVATION, k] > 0.2 and every.satellites[k][0] in letters]  # fmt: skip
    return select_orbits(every, np.array(pick))


def observed(orbits: Orbits) -> tuple[np.ndarray, np.ndarray]:
    """Pseudoranges and range rates when the receiver's clock shows TOW_S."""
    seen = signals_at(orbits, TOW_S - OFFSET_S, PLACE_M, MOTION, AIR)
    code = seen[RANGE] + SPEED_OF_LIGHT_MPS * (OFFSET_S - seen[SAT_CLOCK]) + seen[DELAY]
    code += np.array([GALILEO_M * (name[0] == "E") for name in orbits.satellites])
    return code, seen[RANGE_RATE] + SPEED_OF_LIGHT_MPS * (DRIFT - seen[SAT_CLOCK_RATE])


@pytest.mark.parametrize("letters", ["G", "E", "GE"])
def test_without_errors_position_velocity_and_clock_are_exact(letters: str) -> None:
    orbits = in_view(letters)
    fix = solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR)
    assert (fix.fix_type, fix.satellites) == (3, len(orbits.satellites))
    assert fix.r_ecef_m == pytest.approx(PLACE_M, abs=1e-4)
    assert fix.v_ned_mps == pytest.approx(ned_axes(fix.lat_rad, fix.lon_rad) @ MOTION, abs=1e-4)
    first = OFFSET_S * SPEED_OF_LIGHT_MPS + (GALILEO_M if letters == "E" else 0.0)
    assert fix.clock_m[0] == pytest.approx(first, abs=1e-3)
    if letters == "GE":
        assert fix.clock_m[1] - fix.clock_m[0] == pytest.approx(GALILEO_M, abs=1e-3)


def test_starting_from_the_last_fix_gives_the_same_solution() -> None:
    orbits = in_view()
    first = solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR)
    code, rate = observed(orbits)
    moved = solve_receiver_fix(orbits, TOW_S, code, rate, AIR, first)
    assert moved.r_ecef_m == pytest.approx(PLACE_M, abs=1e-4)
    assert moved.fix_type == 3


def test_a_faulty_satellite_moves_the_position() -> None:
    orbits = in_view()
    code, rate = observed(orbits)
    code[3] += 100.0
    fix = solve_receiver_fix(orbits, TOW_S, code, rate, AIR)
    assert fix.fix_type == 3
    assert np.linalg.norm(fix.r_ecef_m - PLACE_M) > 5.0


@pytest.mark.parametrize(("letters", "count"), [("G", 2), ("E", 2), ("GE", 3), ("G", 1), ("GE", 0)])
def test_too_few_satellites_give_no_fix(letters: str, count: int) -> None:
    every = in_view(letters)
    pick = [0, 1, -1, -2][:count] if letters == "GE" else list(range(count))
    orbits = select_orbits(every, np.array(pick, dtype=int))
    fix = solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR)
    assert fix.fix_type == (1 if count else 0)
    assert np.isinf(fix.sigma_ned_m).all()


def test_one_satellite_too_few_gives_a_2d_fix_at_the_last_height() -> None:
    every = in_view()
    last = solve_receiver_fix(every, TOW_S, *observed(every), AIR)
    few = select_orbits(every, np.array([0, 2, -1, -5]))
    fix = solve_receiver_fix(few, TOW_S, *observed(few), AIR, last)
    assert (fix.fix_type, fix.satellites) == (2, 4)
    assert fix.r_ecef_m == pytest.approx(PLACE_M, abs=1e-3)  # the assumed height is the true one
    assert fix.sigma_ned_m[2] == pytest.approx(50.0, rel=0.01)


@pytest.mark.parametrize("letters", ["G", "E"])
def test_a_2d_fix_without_a_height_is_within_its_sigma(letters: str) -> None:
    every = in_view(letters)
    few = select_orbits(every, np.arange(3))
    fix = solve_receiver_fix(few, TOW_S, *observed(few), AIR)
    assert fix.fix_type == 2
    assert fix.height_m == pytest.approx(0.0, abs=0.01)
    error_m = np.linalg.norm(fix.r_ecef_m - PLACE_M)
    assert 10.0 < error_m < 3.0 * np.linalg.norm(fix.sigma_ned_m)


def test_five_satellites_of_two_systems_are_enough() -> None:
    every = in_view()
    orbits = select_orbits(every, np.array([0, 2, -1, -5, -9]))
    assert solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR).fix_type == 3


def test_the_same_satellite_five_times_is_no_geometry() -> None:
    orbits = select_orbits(in_view("G"), np.array([0, 0, 0, 0, 0]))
    fix = solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR)
    assert fix.fix_type == 1


def test_without_a_fix_the_last_position_is_kept() -> None:
    orbits = in_view("G")
    last = solve_receiver_fix(orbits, TOW_S, *observed(orbits), AIR)
    few = select_orbits(orbits, np.array([0, 1]))
    fix = solve_receiver_fix(few, TOW_S, *observed(few), AIR, last)
    assert fix.fix_type == 1
    assert np.array_equal(fix.r_ecef_m, last.r_ecef_m)


def test_the_error_divided_by_its_own_sigma_has_unit_variance_for_its_noise_model() -> None:
    orbits = in_view()
    code, rate = observed(orbits)
    seen = signals_at(orbits, TOW_S, PLACE_M, MOTION, AIR)
    sigma = 0.5 / np.sin(seen[SAT_ELEVATION])  # the sigma that the receiver assumes
    rng = np.random.default_rng(5)
    fix = NO_FIX
    ratios = []
    for _ in range(600):
        fix = solve_receiver_fix(
            orbits, TOW_S, code + sigma * rng.standard_normal(len(code)), rate, AIR, fix
        )
        error = np.linalg.norm(fix.r_ecef_m - PLACE_M) ** 2
        ratios.append(error / np.sum(fix.sigma_ned_m**2))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)
