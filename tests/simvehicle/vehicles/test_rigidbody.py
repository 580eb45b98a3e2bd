"""Conservation laws and the order of the integrator."""

import numpy as np
import pytest

from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, forces_moments
from simvehicle.vehicles.fixedwing.fixedwing_parameters import aero_coefficients
from simvehicle.vehicles.fixedwing.trim import find_trim
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.parameter_file import body_inertia
from simvehicle.vehicles.rigidbody_kernel import (
    Inertia,
    Loads,
    State13,
    inertia_coefficients,
    runge_kutta_step,
)
from simvehicle.vehicles.vehicle import pack_surroundings

PARAMETERS = FixedWing.read("aerosonde-2025").parameters
BODY, AERO = body_inertia(PARAMETERS, {}), aero_coefficients(PARAMETERS, {})
JX, JY, JZ, JXZ = 0.8244, 1.135, 1.759, 0.1204
J = np.array([[JX, 0.0, -JXZ], [0.0, JY, 0.0], [-JXZ, 0.0, JZ]])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
CONTROLS = (-0.12, 0.02, 0.0, 0.6)
START: State13 = (0.0, 0.0, -100.0, 20.0, 3.0, -4.0, 1.0, 0.0, 0.0, 0.0, 1.2, -0.7, 0.9)


@inlined
def loads(state: State13, stage: int, given: WingInputs) -> Loads:
    """Force and moment of the air, the same at every stage of a step."""
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    wind = to_body(e0, e1, e2, e3, given.wind[0], given.wind[1], given.wind[2])
    air = (u - wind[0], v - wind[1], w - wind[2])
    return forces_moments(air, (p, q, r), given.controls, given.density, given.aero)


@compiled
def fly(
    state: State13,
    controls: tuple[float, float, float, float],
    gravity: float,
    density: float,
    body: Inertia,
    aero: Aero,
    dt: float,
    n: int,
    wind: float,
) -> State13:
    air, down = (wind, -2.0 * wind, 0.0), (0.0, 0.0, gravity)
    given = WingInputs(controls, air, down, density, body, aero)
    for _ in range(n):
        state = runge_kutta_step(state, loads, given, down, body, dt)
    return state


def flown(
    start: State13, seconds: float, dt: float, gravity: float = 9.81, density: float = 0.0
) -> np.ndarray:
    """State (13,) after a time."""
    return np.array(
        fly(start, CONTROLS, gravity, density, BODY, AERO, dt, round(seconds / dt), 1.0)
    )


def angular_momentum(x: np.ndarray) -> np.ndarray:
    """In NED [kg m^2/s]."""
    return np.asarray(matrix_from_quat(x[6:10]) @ (J @ x[10:13]))


def energy(x: np.ndarray, gravity: float) -> float:
    """Kinetic and potential [J]."""
    mass = BODY.mass_kg
    moving = 0.5 * mass * x[3:6] @ x[3:6] + 0.5 * x[10:13] @ J @ x[10:13]
    return float(moving - mass * gravity * x[2])


def test_a_body_without_air_keeps_its_angular_momentum() -> None:
    start, end = np.array(START), flown(START, 20.0, 0.005)
    assert np.allclose(angular_momentum(end), angular_momentum(start), rtol=1e-8, atol=1e-7)


def test_a_body_without_air_keeps_its_energy() -> None:
    start, end = np.array(START), flown(START, 20.0, 0.005)
    assert energy(end, 9.81) == pytest.approx(energy(start, 9.81), rel=1e-9)


def test_without_air_and_gravity_the_velocity_over_ground_stays() -> None:
    end = flown(START, 20.0, 0.005, gravity=0.0)
    velocity = matrix_from_quat(end[6:10]) @ end[3:6]
    assert np.allclose(velocity, START[3:6], atol=1e-7)
    assert np.allclose(end[:3], np.array(START[:3]) + 20.0 * np.array(START[3:6]), atol=1e-6)


def test_a_body_without_air_falls_by_half_g_t_squared() -> None:
    end = flown((0.0, 0.0, -100.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 3.0, 0.01)
    assert end[2] == pytest.approx(-100.0 + 0.5 * 9.81 * 9.0, abs=1e-9)


def test_a_multirotor_without_air_and_motors_falls_with_conserved_momentum() -> None:
    iris = Multirotor.read("iris")
    start = iris.start(np.array([0.0, 0.0, -100.0]), np.array([3.0, 1.0, 0.0]), UPRIGHT)
    around = pack_surroundings(np.zeros(3), np.array([0.0, 0.0, 9.81]), 0.0, 0.0, np.empty(9))
    end, load = iris.advance(start, np.zeros(4), around, 600, 0.005)
    assert end[:3] == pytest.approx([9.0, 3.0, -100.0 + 0.5 * 9.81 * 9.0], abs=1e-9)
    assert end[3:6] == pytest.approx([3.0, 1.0, 9.81 * 3.0], abs=1e-9)
    assert load[:3] == pytest.approx([0.0, 0.0, 0.0])  # weightless


def test_rotation_about_the_middle_axis_is_unstable_and_about_the_largest_is_not() -> None:
    body = inertia_coefficients(1.0, 1.0, 2.0, 2.5, 0.0)
    rest = (0.0,) * 3 + (0.0,) * 3 + (1.0, 0.0, 0.0, 0.0)

    def wobble(state: State13) -> float:
        worst = 0.0
        for _ in range(100):
            state = fly(state, CONTROLS, 0.0, 0.0, body, AERO, 0.005, 20, 0.0)
            worst = max(worst, abs(state[10]))
        return worst

    assert wobble((*rest, 1e-3, 3.0, 0.0)) > 1.0
    assert wobble((*rest, 1e-3, 0.0, 3.0)) < 2e-3


def test_halving_the_step_divides_the_error_by_sixteen() -> None:
    def end(dt: float) -> np.ndarray:
        return flown(START, 2.0, dt, density=1.2)

    exact = end(0.00125)
    coarse, fine = (np.linalg.norm(end(dt) - exact) for dt in (0.02, 0.01))
    assert 3.6 < np.log2(coarse / fine) < 4.4


def test_a_single_vehicle_uses_the_same_equations_as_a_batch() -> None:
    vehicle = FixedWing.read("aerosonde-2025")
    throw = np.array([*vehicle.throw_rad, 1.0])
    around = pack_surroundings(
        np.array([1.0, -2.0, 0.0]), np.array([0.0, 0.0, 9.81]), 1.2, 0.0, np.empty(9)
    )
    end, _ = vehicle.advance(np.append(START, 0.0), np.array(CONTROLS) / throw, around, 200, 0.005)
    assert end[:13] == pytest.approx(flown(START, 1.0, 0.005, density=1.2), rel=1e-11, abs=1e-11)


def test_the_quaternion_keeps_its_length() -> None:
    end = flown(START, 20.0, 0.01, density=1.2)
    assert np.linalg.norm(end[6:10]) == pytest.approx(1.0, abs=1e-14)


def test_trimmed_flight_stays_trimmed() -> None:
    point = find_trim(25.0, BODY, AERO)
    s, c = np.sin(point.pitch_rad / 2), np.cos(point.pitch_rad / 2)
    u, w = 25.0 * np.cos(point.alpha_rad), 25.0 * np.sin(point.alpha_rad)
    state = (0.0, 0.0, -100.0, u, 0.0, w, c, 0.0, s, 0.0, 0.0, 0.0, 0.0)

    controls = tuple(point.controls().tolist())
    end = np.array(fly(state, controls, 9.81, 1.2682, BODY, AERO, 0.01, 500, 0.0))
    assert end[2] == pytest.approx(-100.0, abs=0.05)
    assert np.allclose(end[3:6], state[3:6], atol=0.02)


def test_thrust_of_the_dc_motor_falls_with_airspeed() -> None:
    from simvehicle.vehicles.fixedwing.fixedwing_kernel import propulsion_output

    @compiled
    def at(airspeed: float) -> tuple[float, float, float]:
        return propulsion_output(airspeed, 0.8, 1.2682, AERO)

    thrusts = [at(speed)[0] for speed in (0.0, 10.0, 20.0, 30.0)]
    assert thrusts == sorted(thrusts, reverse=True)
    assert at(25.0)[2] > 0.0


@pytest.mark.parametrize("moments", [(0.0, 1.0, 1.0, 0.0), (1.0, 1.0, 3.0, 0.0), (1, 1, 1, 1.5)])
def test_impossible_moments_of_inertia_are_refused(
    moments: tuple[float, float, float, float],
) -> None:
    with pytest.raises(ValueError, match="is no rigid body"):
        inertia_coefficients(1.0, *moments)
