"""The parts of one time step, each a loop over the lanes of a buffer (see `rows`).

Truth by `simvehicle`'s own kernels, sensors with noise, faults on the sensors' signals, envelope
and scores. Every loop body is branch-free, so that LLVM turns it into SIMD code.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.search.lanes import rows
from analysis.search.lanes.noise_kernel import gauss_pair, next_bits
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.vehicles.fixedwing.fixedwing_flight import AILERON, ELEVATOR, RUDDER, THROTTLE
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, state_derivative
from simvehicle.vehicles.rigidbody_kernel import (
    DOWN,
    E0,
    E1,
    E2,
    E3,
    EAST,
    NORTH,
    Inertia,
    P,
    Q,
    R,
    State13,
    U,
    V,
    W,
    finish_step,
)

L = rows.LANES
S = rows.STATE * L
NOW = rows.NOW * L
NOW_RATE = NOW + P * L
C = rows.CONTROL * L
WIND = rows.WIND * L
F = rows.FORCE * L
RATE, ACCEL = rows.GYRO * L, rows.ACCEL * L
N = rows.NOISE * L
GS, AS = rows.GYRO_SIGMA * L, rows.ACCEL_SIGMA * L
GB, AB = rows.GYRO_BIAS * L, rows.ACCEL_BIAS * L
ALIVE, BROKEN_LIMIT = rows.ALIVE * L, rows.BROKEN_LIMIT * L

Buffer = NDArray[np.float64]
Three = tuple[float, float, float]
World = tuple[float, float]  # gravity in m/s^2, density of the air in kg/m^3


@compiled
def gather(buf: Buffer, first: int, count: int, lane: int) -> Buffer:
    """Some rows of one lane (count,) from the offset `first` on."""
    out = np.empty(count)
    for i in range(count):
        out[i] = buf[first + i * L + lane]
    return out


@inlined
def state_at(buf: Buffer, lane: int) -> State13:
    """The state of one lane before the step."""
    return (
        buf[S + NORTH * L + lane],
        buf[S + EAST * L + lane],
        buf[S + DOWN * L + lane],
        buf[S + U * L + lane],
        buf[S + V * L + lane],
        buf[S + W * L + lane],
        buf[S + E0 * L + lane],
        buf[S + E1 * L + lane],
        buf[S + E2 * L + lane],
        buf[S + E3 * L + lane],
        buf[S + P * L + lane],
        buf[S + Q * L + lane],
        buf[S + R * L + lane],
    )


@inlined
def true_attitude(buf: Buffer, lane: int) -> tuple[float, float, float, float]:
    """The quaternion when the sensors sampled."""
    return (
        buf[NOW + E0 * L + lane],
        buf[NOW + E1 * L + lane],
        buf[NOW + E2 * L + lane],
        buf[NOW + E3 * L + lane],
    )


@inlined
def true_velocity(buf: Buffer, lane: int) -> Three:
    """The velocity over ground in body axes when the sensors sampled."""
    return (buf[NOW + U * L + lane], buf[NOW + V * L + lane], buf[NOW + W * L + lane])


@inlined
def air_velocity(buf: Buffer, lane: int) -> Three:
    """The velocity through the air in body axes when the sensors sampled."""
    e0, e1, e2, e3 = true_attitude(buf, lane)
    u, v, w = true_velocity(buf, lane)
    north, east, down = buf[WIND + lane], buf[WIND + L + lane], buf[WIND + 2 * L + lane]
    x, y, z = to_body(e0, e1, e2, e3, north, east, down)
    return (u - x, v - y, w - z)


@inlined
def put_state(buf: Buffer, row: int, lane: int, state: State13) -> None:
    """Write a state from the offset `row` on."""
    # Written out, as a loop over a tuple would keep LLVM from making SIMD code of it.
    north, east, down, u, v, w, e0, e1, e2, e3, p, q, r = state
    buf[row + NORTH * L + lane] = north
    buf[row + EAST * L + lane] = east
    buf[row + DOWN * L + lane] = down
    buf[row + U * L + lane] = u
    buf[row + V * L + lane] = v
    buf[row + W * L + lane] = w
    buf[row + E0 * L + lane] = e0
    buf[row + E1 * L + lane] = e1
    buf[row + E2 * L + lane] = e2
    buf[row + E3 * L + lane] = e3
    buf[row + P * L + lane] = p
    buf[row + Q * L + lane] = q
    buf[row + R * L + lane] = r


@inlined
def chosen(first: bool, one: State13, other: State13) -> State13:
    """The state `one` if `first`, else the state `other`."""
    n, e, d, u, v, w, e0, e1, e2, e3, p, q, r = one
    n_, e_, d_, u_, v_, w_, e0_, e1_, e2_, e3_, p_, q_, r_ = other
    return (
        n if first else n_,
        e if first else e_,
        d if first else d_,
        u if first else u_,
        v if first else v_,
        w if first else w_,
        e0 if first else e0_,
        e1 if first else e1_,
        e2 if first else e2_,
        e3 if first else e3_,
        p if first else p_,
        q if first else q_,
        r if first else r_,
    )


class Envelope(NamedTuple):
    """Limits of a flight that counts, in SI units; some are tangents or sines of angles."""

    sin_pitch: float
    tan_alpha: float
    tan_beta: float
    min_airspeed_mps: float
    max_airspeed_mps: float
    rate_rps: float
    load_mps2: float
    min_height_m: float


@inlined
def broken(state: State13, air: Three, force: Three, limits: Envelope, hovers: bool) -> float:
    """The number of the limit that a state breaks (see `rows.LIMITS`), 0 within the envelope.

    If it `hovers`, airspeed and flow angles are not limited.
    """
    u, v, w = air
    plane = u * u + w * w
    speed = plane + v * v  # squares, which saves two roots
    low, high = limits.min_airspeed_mps, limits.max_airspeed_mps
    _, _, down, _, _, _, e0, e1, e2, e3, p, q, r = state
    fx, fy, fz = force
    load = fx * fx + fy * fy + fz * fz
    limit = 7.0 if -down <= limits.min_height_m else 0.0
    limit = limit if load <= limits.load_mps2 * limits.load_mps2 else 6.0
    limit = limit if p * p + q * q + r * r <= limits.rate_rps * limits.rate_rps else 5.0
    limit = limit if hovers | ((speed >= low * low) & (speed <= high * high)) else 4.0
    limit = limit if hovers | (v * v <= limits.tan_beta * limits.tan_beta * plane) else 3.0
    limit = limit if hovers | (abs(w) <= limits.tan_alpha * u) else 2.0
    sine = 2.0 * (e0 * e2 - e3 * e1)
    return limit if abs(sine) <= limits.sin_pitch else 1.0


@inlined
def observe(
    buf: Buffer, lane: int, state: State13, rate: State13, gravity: float, limits: Envelope,
    hovers: bool,
) -> bool:  # fmt: skip
    """Write to FORCE and NOW what the sensors see at a state with its first slope; return whether
    the lane is alive, which one out of the envelope is not."""
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    gx, gy, gz = to_body(e0, e1, e2, e3, 0.0, 0.0, gravity)
    _, _, _, du, dv, dw, _, _, _, _, _, _, _ = rate
    # What the body feels: its acceleration without gravity and the turning of its axes.
    force = (
        du - (r * v - q * w) - gx,
        dv - (p * w - r * u) - gy,
        dw - (q * u - p * v) - gz,
    )
    buf[F + lane], buf[F + L + lane], buf[F + 2 * L + lane] = force
    put_state(buf, NOW, lane, state)
    wx, wy, wz = to_body(
        e0, e1, e2, e3, buf[WIND + lane], buf[WIND + L + lane], buf[WIND + 2 * L + lane]
    )
    limit = broken(state, (u - wx, v - wy, w - wz), force, limits, hovers)
    was_alive = buf[ALIVE + lane] > 0.5
    alive: bool = was_alive & (limit < 0.5)
    buf[BROKEN_LIMIT + lane] = limit if was_alive else buf[BROKEN_LIMIT + lane]
    buf[ALIVE + lane] = 1.0 if alive else 0.0
    return alive


@compiled
def move(buf: Buffer, dt: float, world: World, body: Inertia, aero: Aero, limits: Envelope) -> None:
    """One Runge-Kutta step; FORCE and NOW take what the sensors see at its start.

    A lane that is out of the envelope at the start stays where it is, dead.
    """
    wide()
    gravity, density = world
    for lane in range(L):
        state = state_at(buf, lane)
        controls = (
            buf[C + ELEVATOR * L + lane],
            buf[C + AILERON * L + lane],
            buf[C + RUDDER * L + lane],
            buf[C + THROTTLE * L + lane],
        )
        wind = (buf[WIND + lane], buf[WIND + L + lane], buf[WIND + 2 * L + lane])
        given = WingInputs(controls, wind, (0.0, 0.0, gravity), density, body, aero)
        k1 = state_derivative(state, given)
        alive = observe(buf, lane, state, k1, gravity, limits, False)
        after = finish_step(state, k1, state_derivative, given, given, dt)
        put_state(buf, S, lane, chosen(alive, after, state))


@compiled
def living(buf: Buffer) -> int:
    """How many lanes are alive."""
    total = 0
    for lane in range(L):
        total += 1 if buf[ALIVE + lane] > 0.5 else 0
    return total


@compiled
def draw(buf: Buffer, generators: NDArray[np.uint64]) -> None:
    """Six Gaussian numbers for each lane; its generator (LANES,) moves on."""
    wide()
    for lane in range(L):
        a = next_bits(generators[lane])
        b = next_bits(a)
        c = next_bits(b)
        generators[lane] = c
        buf[N + lane], buf[N + L + lane] = gauss_pair(a)
        buf[N + 2 * L + lane], buf[N + 3 * L + lane] = gauss_pair(b)
        buf[N + 4 * L + lane], buf[N + 5 * L + lane] = gauss_pair(c)


@compiled
def sense_imu(buf: Buffer) -> None:
    """Rates and specific force with bias and noise, noise drawn before."""
    for lane in range(L):
        gyro, accel = buf[GS + lane], buf[AS + lane]
        for i in range(3):
            k = i * L + lane
            buf[RATE + k] = buf[NOW_RATE + k] + buf[GB + k] + gyro * buf[N + k]
            buf[ACCEL + k] = buf[F + k] + buf[AB + k] + accel * buf[N + 3 * L + k]
