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
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, state_derivative
from simvehicle.vehicles.rigidbody_kernel import E0, E3, Inertia, P, State13, U, finish_step

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
Four = tuple[float, float, float, float]
World = tuple[float, float]  # gravity in m/s^2, density of the air in kg/m^3


@compiled
def gather(buf: Buffer, first: int, count: int, lane: int) -> Buffer:
    """Some rows of one lane (count,) from the offset `first` on."""
    out = np.empty(count)
    for i in range(count):
        out[i] = buf[first + i * L + lane]
    return out


@inlined
def three_at(buf: Buffer, first: int, lane: int) -> Three:
    """Three rows of one lane from the offset `first` on."""
    # Written out, as a loop over a tuple would keep LLVM from making SIMD code of it.
    return buf[first + lane], buf[first + L + lane], buf[first + 2 * L + lane]


@inlined
def four_at(buf: Buffer, first: int, lane: int) -> Four:
    """Four rows of one lane from the offset `first` on."""
    return three_at(buf, first, lane) + (buf[first + 3 * L + lane],)  # noqa: RUF005


@inlined
def put_three(buf: Buffer, first: int, lane: int, values: Three, new: bool = True) -> None:
    """Write three rows of one lane from the offset `first` on, unless they are not `new`."""
    x, y, z = values
    buf[first + lane] = x if new else buf[first + lane]
    buf[first + L + lane] = y if new else buf[first + L + lane]
    buf[first + 2 * L + lane] = z if new else buf[first + 2 * L + lane]


@inlined
def state_at(buf: Buffer, lane: int) -> State13:
    """The state of one lane before the step."""
    motion = three_at(buf, S, lane) + three_at(buf, S + U * L, lane)
    return motion + four_at(buf, S + E0 * L, lane) + three_at(buf, S + P * L, lane)


@inlined
def true_attitude(buf: Buffer, lane: int) -> Four:
    """The quaternion when the sensors sampled."""
    return four_at(buf, NOW + E0 * L, lane)


@inlined
def air_velocity(buf: Buffer, lane: int) -> Three:
    """The velocity through the air in body axes when the sensors sampled."""
    e0, e1, e2, e3 = true_attitude(buf, lane)
    u, v, w = three_at(buf, NOW + U * L, lane)
    north, east, down = three_at(buf, WIND, lane)
    x, y, z = to_body(e0, e1, e2, e3, north, east, down)
    return (u - x, v - y, w - z)


@inlined
def put_state(buf: Buffer, first: int, lane: int, state: State13, new: bool = True) -> None:
    """Write a state from the offset `first` on, unless it is not `new`."""
    put_three(buf, first, lane, state[:3], new)
    put_three(buf, first + U * L, lane, state[3:6], new)
    put_three(buf, first + E0 * L, lane, state[6:9], new)
    buf[first + E3 * L + lane] = state[9] if new else buf[first + E3 * L + lane]
    put_three(buf, first + P * L, lane, state[10:], new)


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
    put_three(buf, F, lane, force)
    put_state(buf, NOW, lane, state)
    limit = broken(state, air_velocity(buf, lane), force, limits, hovers)
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
        controls, wind = four_at(buf, C, lane), three_at(buf, WIND, lane)
        given = WingInputs(controls, wind, (0.0, 0.0, gravity), density, body, aero)
        k1 = state_derivative(state, given)
        alive = observe(buf, lane, state, k1, gravity, limits, False)
        after = finish_step(state, k1, state_derivative, given, given, dt)
        put_state(buf, S, lane, after, alive)


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
