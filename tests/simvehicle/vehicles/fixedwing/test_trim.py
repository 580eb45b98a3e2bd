"""Trim and modes of the fixed wing against an independent computation with the same parameters."""

import numpy as np
import pytest

from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_parameters import aero_coefficients
from simvehicle.vehicles.fixedwing.trim import (
    euler_derivative,
    find_trim,
    linearise_trim,
)
from simvehicle.vehicles.parameter_file import body_inertia

# Set, airspeed [m/s], angle of attack [deg], elevator [rad], throttle, longitudinal and lateral
# eigenvalues with non-negative imaginary part [1/s]; computed separately from the published
# equations with the first edition's thrust law, density 1.2682 kg/m^3, gravity 9.81 m/s^2.
TABLE = [
    (
        *("aerosonde-2012", 35.0, 0.20, -0.0494, 0.464),
        [-1.94 + 5.07j, -0.37 + 0.10j],
        [-16.4, -5.2 + 12.3j, -0.029],
    ),
    (
        *("aerosonde-2025-thrust-law", 25.0, 2.85, -0.1239, 0.332),
        [-4.90 + 9.87j, -0.32 + 0.37j],
        [-22.4, -1.14 + 4.66j, 0.089],
    ),
    (
        *("aerosonde-2025-thrust-law", 35.0, 0.23, 0.0028, 0.463),
        [-6.85 + 13.8j, -0.74, -0.17],
        [-31.7, -1.44 + 6.41j, 0.054],
    ),
    (
        *("aerosonde-2025-matlab", 25.0, 2.87, -0.1250, 0.314),
        [-4.88 + 9.87j, -0.29 + 0.40j],
        [-23.3, -1.13 + 5.81j, -0.052],
    ),
    (
        *("zagi-2012", 17.0, 4.80, -0.218, 0.720),
        [-4.96 + 12.0j, -0.14 + 0.76j],
        [-7.9, -0.06 + 1.23j, -0.053],
    ),
]


def _matches(modes: np.ndarray, expected: list[complex]) -> bool:
    """Every expected mode matches within 1 % or half a unit of its last printed digit."""
    for mode in expected:
        nearest = min(modes, key=lambda value: abs(value - mode))
        for got, want in ((nearest.real, mode.real), (nearest.imag, complex(mode).imag)):
            decimals = len(f"{want:g}".partition(".")[2])
            if abs(got - want) > max(0.01 * abs(want), 0.51 * 10.0**-decimals):
                return False
    return True


@pytest.mark.parametrize(
    ("name", "airspeed", "alpha_deg", "elevator", "throttle", "longitudinal", "lateral"), TABLE
)
def test_trim_and_modes_are_those_of_the_table(
    name: str,
    airspeed: float,
    alpha_deg: float,
    elevator: float,
    throttle: float,
    longitudinal: list[complex],
    lateral: list[complex],
) -> None:
    parameters = FixedWing.read(name).parameters
    body, aero = body_inertia(parameters, {}), aero_coefficients(parameters, {})
    point = find_trim(airspeed, body, aero)
    assert np.degrees(point.alpha_rad) == pytest.approx(alpha_deg, abs=0.006)
    assert point.elevator_rad == pytest.approx(elevator, abs=2e-4)
    assert point.throttle == pytest.approx(throttle, abs=6e-4)
    rates = linearise_trim(point, body, aero)[0]
    # u, w, pitch, q; v, roll, p, r
    for states, modes in (([3, 5, 7, 10], longitudinal), ([4, 6, 9, 11], lateral)):
        found = np.linalg.eigvals(rates[np.ix_(states, states)]).astype(complex)
        assert _matches(np.sort(found), modes)


def test_a_trimmed_climb_is_steady_and_climbs() -> None:
    parameters = FixedWing.read("aerosonde-2025").parameters
    body, aero = body_inertia(parameters, {}), aero_coefficients(parameters, {})
    point = find_trim(25.0, body, aero, climb_rad=0.1)
    rate = euler_derivative(point.state12(), point.controls(), body, aero, 1.2682, 9.81)
    assert np.allclose(rate[3:], 0.0, atol=1e-6)
    assert -rate[2] == pytest.approx(25.0 * np.sin(0.1), rel=1e-6)


def test_a_speed_the_airframe_cannot_fly_is_refused() -> None:
    parameters = FixedWing.read("aerosonde-2012").parameters
    with pytest.raises(ValueError, match="no straight flight at 5"):
        find_trim(5.0, body_inertia(parameters, {}), aero_coefficients(parameters, {}))
