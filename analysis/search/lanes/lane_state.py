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
from mavproxy_fault.numerics.rotation_kernel import to_body
from simvehicle.vehicles.fixedwing_kernel import Aero, derivative
from simvehicle.vehicles.rigidbody_kernel import Inertia, State13, moved, runge_kutta

L = rows.LANES
S = rows.STATE * L
NOW = rows.NOW * L
C = rows.CONTROL * L
W = rows.WIND * L
F = rows.FORCE * L
M = rows.MEASURED * L
N = rows.NOISE * L
GS, AS = rows.GYRO_SIGMA * L, rows.ACCEL_SIGMA * L
GB, AB = rows.GYRO_BIAS * L, rows.ACCEL_BIAS * L
ALIVE, BROKEN_LIMIT = rows.ALIVE * L, rows.BROKEN_LIMIT * L

Buffer = NDArray[np.float64]
Three = tuple[float, float, float]
World = tuple[float, float]  # gravity in m/s^2, density of the air in kg/m^3


@inlined
def state_at(buf: Buffer, lane: int) -> State13:
    """The state of one lane before the step."""
    return (
        buf[S + lane],
        buf[S + L + lane],
        buf[S + 2 * L + lane],
        buf[S + 3 * L + lane],
        buf[S + 4 * L + lane],
        buf[S + 5 * L + lane],
        buf[S + 6 * L + lane],
        buf[S + 7 * L + lane],
        buf[S + 8 * L + lane],
        buf[S + 9 * L + lane],
        buf[S + 10 * L + lane],
        buf[S + 11 * L + lane],
        buf[S + 12 * L + lane],
    )


class Envelope(NamedTuple):
    """Limits of a flight that counts, in SI units and as tangents or sines of angles where told."""

    sin_pitch: float
    tan_alpha: float
    tan_beta: float
    min_airspeed_mps: float
    max_airspeed_mps: float
    rate_rps: float
    load_mps2: float
    min_height_m: float


@inlined
def broken(state: State13, air: Three, force: Three, limits: Envelope) -> float:
    """The number of the limit that a state breaks (see `rows.LIMITS`), 0 within the envelope."""
    u, v, w = air
    plane = u * u + w * w
    speed = plane + v * v  # squares, which saves two roots
    low, high = limits.min_airspeed_mps, limits.max_airspeed_mps
    p, q, r = state[10], state[11], state[12]
    fx, fy, fz = force
    load = fx * fx + fy * fy + fz * fz
    limit = 7.0 if -state[2] <= limits.min_height_m else 0.0
    limit = limit if load <= limits.load_mps2 * limits.load_mps2 else 6.0
    limit = limit if p * p + q * q + r * r <= limits.rate_rps * limits.rate_rps else 5.0
    limit = limit if (speed >= low * low) & (speed <= high * high) else 4.0
    limit = limit if v * v <= limits.tan_beta * limits.tan_beta * plane else 3.0
    limit = limit if abs(w) <= limits.tan_alpha * u else 2.0
    sine = 2.0 * (state[6] * state[8] - state[9] * state[7])
    return limit if abs(sine) <= limits.sin_pitch else 1.0


@compiled
def move(buf: Buffer, dt: float, world: World, body: Inertia, aero: Aero, limits: Envelope) -> None:
    """One Runge-Kutta step; FORCE and NOW take what the sensors see at its start.

    The same stages as `fixedwing_kernel.step`, which does not show its first slope. A lane that is
    out of the envelope at the start stays where it is, dead.
    """
    wide()
    gravity, density = world
    for lane in range(L):
        state = state_at(buf, lane)
        controls = (buf[C + lane], buf[C + L + lane], buf[C + 2 * L + lane], buf[C + 3 * L + lane])
        wind = (buf[W + lane], buf[W + L + lane], buf[W + 2 * L + lane])
        down = (0.0, 0.0, gravity)
        k1 = derivative(state, controls, wind, down, density, body, aero)
        u, v, w, p, q, r = state[3], state[4], state[5], state[10], state[11], state[12]
        gx, gy, gz = to_body(state[6], state[7], state[8], state[9], 0.0, 0.0, gravity)
        force = (
            k1[3] - (r * v - q * w) - gx,
            k1[4] - (p * w - r * u) - gy,
            k1[5] - (q * u - p * v) - gz,
        )
        buf[F + lane], buf[F + L + lane], buf[F + 2 * L + lane] = force
        buf[NOW + lane] = state[0]
        buf[NOW + L + lane] = state[1]
        buf[NOW + 2 * L + lane] = state[2]
        buf[NOW + 3 * L + lane] = state[3]
        buf[NOW + 4 * L + lane] = state[4]
        buf[NOW + 5 * L + lane] = state[5]
        buf[NOW + 6 * L + lane] = state[6]
        buf[NOW + 7 * L + lane] = state[7]
        buf[NOW + 8 * L + lane] = state[8]
        buf[NOW + 9 * L + lane] = state[9]
        buf[NOW + 10 * L + lane] = state[10]
        buf[NOW + 11 * L + lane] = state[11]
        buf[NOW + 12 * L + lane] = state[12]
        wx, wy, wz = to_body(state[6], state[7], state[8], state[9], wind[0], wind[1], wind[2])
        limit = broken(state, (u - wx, v - wy, w - wz), force, limits)
        was_alive = buf[ALIVE + lane] > 0.5
        alive = was_alive & (limit < 0.5)
        buf[BROKEN_LIMIT + lane] = limit if was_alive else buf[BROKEN_LIMIT + lane]
        buf[ALIVE + lane] = 1.0 if alive else 0.0
        k2 = derivative(moved(state, k1, 0.5 * dt), controls, wind, down, density, body, aero)
        k3 = derivative(moved(state, k2, 0.5 * dt), controls, wind, down, density, body, aero)
        k4 = derivative(moved(state, k3, dt), controls, wind, down, density, body, aero)
        after = runge_kutta(state, k1, k2, k3, k4, dt)
        buf[S + lane] = after[0] if alive else state[0]
        buf[S + L + lane] = after[1] if alive else state[1]
        buf[S + 2 * L + lane] = after[2] if alive else state[2]
        buf[S + 3 * L + lane] = after[3] if alive else state[3]
        buf[S + 4 * L + lane] = after[4] if alive else state[4]
        buf[S + 5 * L + lane] = after[5] if alive else state[5]
        buf[S + 6 * L + lane] = after[6] if alive else state[6]
        buf[S + 7 * L + lane] = after[7] if alive else state[7]
        buf[S + 8 * L + lane] = after[8] if alive else state[8]
        buf[S + 9 * L + lane] = after[9] if alive else state[9]
        buf[S + 10 * L + lane] = after[10] if alive else state[10]
        buf[S + 11 * L + lane] = after[11] if alive else state[11]
        buf[S + 12 * L + lane] = after[12] if alive else state[12]


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
        buf[M + lane] = buf[NOW + 10 * L + lane] + buf[GB + lane] + gyro * buf[N + lane]
        buf[M + L + lane] = buf[NOW + 11 * L + lane] + buf[GB + L + lane] + gyro * buf[N + L + lane]
        buf[M + 2 * L + lane] = (
            buf[NOW + 12 * L + lane] + buf[GB + 2 * L + lane] + gyro * buf[N + 2 * L + lane]
        )
        buf[M + 3 * L + lane] = buf[F + lane] + buf[AB + lane] + accel * buf[N + 3 * L + lane]
        buf[M + 4 * L + lane] = (
            buf[F + L + lane] + buf[AB + L + lane] + accel * buf[N + 4 * L + lane]
        )
        buf[M + 5 * L + lane] = (
            buf[F + 2 * L + lane] + buf[AB + 2 * L + lane] + accel * buf[N + 5 * L + lane]
        )
