"""A quadrotor over lanes: the simulator's own rotors, motors and feedback."""

from typing import NamedTuple

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import (
    Buffer,
    Envelope,
    Three,
    World,
    four_at,
    observe,
    put_state,
    state_at,
    three_at,
)
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.polynomial import exp
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned
from mavproxy_fault.numerics.rotations.rotation_lanes import euler_of_quaternion
from simvehicle.vehicles.multirotor.multirotor_flight import Airframe, body_drag, rotor_loads
from simvehicle.vehicles.multirotor.sway_kernel import (
    Four,
    QuadParameters,
    SwayFeedback,
    sway_commands,
)
from simvehicle.vehicles.rigidbody_kernel import (
    Inertia,
    State13,
    finish_step,
    rigid_body_derivative,
)

L = rows.LANES
C, M, T, W = rows.CONTROL * L, rows.MOTOR * L, rows.MISSION * L, rows.WIND * L
START = rows.START_DOWN * L
MOTORS = 4


class QuadModel(NamedTuple):
    """A quadrotor: coefficients, each rotor's place, turning and efficiency, and its feedback."""

    frame: Airframe
    rotors: tuple[Four, Four, Four, Four]
    control: QuadParameters


@compiled
def steer_quad(buf: Buffer, t_s: float, world: World, control: QuadParameters) -> None:
    """CONTROL from the mission and feedback of the truth, at the height of the start."""
    wide()
    gravity, density = world
    for lane in range(L):
        state = state_at(buf, lane)
        _, _, down, u, v, w, e0, e1, e2, e3, p, q, r = state
        roll, pitch, _ = euler_of_quaternion(e0, e1, e2, e3)
        _, _, sink = to_ned(e0, e1, e2, e3, u, v, w)
        now = SwayFeedback(roll, pitch, (p, q, r), buf[START + lane] - down, -sink)
        aim = three_at(buf, T + L, lane)
        motors = sway_commands(now, aim, control, gravity, density / SEA_LEVEL_DENSITY_KGPM3, t_s)
        for i in range(MOTORS):
            buf[C + i * L + lane] = motors[i]


@inlined
def _speed_after(speed: float, command: float, frame: Airframe, dt: float) -> float:
    """A motor's speed [rad/s] after a time, exactly; commands are 0 to 1 and never 0."""
    wanted = frame.idle + (frame.full - frame.idle) * command
    lag = frame.spin_up_s if wanted > speed else frame.spin_down_s
    return wanted + (speed - wanted) * exp(-dt / lag)


@inlined
def _speeds_after(speeds: Four, commands: Four, frame: Airframe, dt: float) -> Four:
    """The speeds of all motors after a time."""
    return (
        _speed_after(speeds[0], commands[0], frame, dt),
        _speed_after(speeds[1], commands[1], frame, dt),
        _speed_after(speeds[2], commands[2], frame, dt),
        _speed_after(speeds[3], commands[3], frame, dt),
    )


class _RotorInputs(NamedTuple):
    """The inputs of `_rotor_rate` besides the state, at one instant of a step."""

    speeds: Four
    wind: Three
    world: World
    body: Inertia
    model: QuadModel


@inlined
def _rotor_rate(state: State13, given: _RotorInputs) -> State13:
    """Time derivative of the 13 states."""
    speeds, model, wind = given.speeds, given.model, given.wind
    gravity, density = given.world
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    air = (u - wx, v - wy, w - wz)
    fx, fy, fz, mx, my, mz = body_drag(air, (p, q, r), density, model.frame)
    for i in range(MOTORS):
        one = rotor_loads((air[0], air[1]), r, speeds[i], model.rotors[i], density, model.frame)
        fx, fy, fz = fx + one[0], fy + one[1], fz + one[2]
        mx, my, mz = mx + one[3], my + one[4], mz + one[5]
    return rigid_body_derivative(state, (fx, fy, fz), (mx, my, mz), (0.0, 0.0, gravity), given.body)


@compiled
def move_quad(
    buf: Buffer, dt: float, world: World, body: Inertia, model: QuadModel, limits: Envelope
) -> None:
    """As `move`, for a quadrotor; its motors' speeds move on too."""
    wide()
    gravity, _ = world
    for lane in range(L):
        state = state_at(buf, lane)
        wind, first, wanted = three_at(buf, W, lane), four_at(buf, M, lane), four_at(buf, C, lane)
        middle = _speeds_after(first, wanted, model.frame, 0.5 * dt)
        last = _speeds_after(first, wanted, model.frame, dt)
        k1 = _rotor_rate(state, _RotorInputs(first, wind, world, body, model))
        alive = observe(buf, lane, state, k1, gravity, limits, True)
        half_way = _RotorInputs(middle, wind, world, body, model)
        end = _RotorInputs(last, wind, world, body, model)
        after = finish_step(state, k1, _rotor_rate, half_way, end, dt)
        put_state(buf, rows.STATE * L, lane, after, alive)
        for i in range(MOTORS):
            buf[M + i * L + lane] = last[i] if alive else first[i]
