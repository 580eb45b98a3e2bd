"""GLONASS orbits: Runge-Kutta propagation of broadcast state vectors.

The frame is PZ-90.11, which agrees with WGS 84 to centimetres [1]_. GLONASS uses UTC; timestamps
here are GPS time.

References
----------
.. [1] GLONASS ICD, edition 5.1, 2008, sections 3.3.3, 4.4 and appendix 3.1.2; PZ-90.11, 2014.
"""

import numpy as np

from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

VELOCITY = 3  # offset of the velocity in a state, after the position

CENTRE_HZ, CHANNEL_HZ = 1602.0e6, 0.5625e6  # L1 of channel 0, and channel spacing [1]_
G2_HZ = 1246.0e6  # L2 of channel 0; its ratio to L1 is equal for all channels
STEP_S = 60.0


@compiled
def _state_derivative(s: Vector, a: Vector, out: Vector) -> None:
    """Write the derivative (6,) of position and velocity s (6,) in the rotating frame to `out`."""
    # PZ-90 constants, which the broadcast vectors assume [1]_.
    mu, j2, radius, rate = 3.9860044e14, 1.0826257e-3, 6378136.0, 7.292115e-5
    square = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    pull = mu / (square * np.sqrt(square))
    bulge = 1.5 * j2 * pull * radius * radius / square
    tilt = 5.0 * s[2] * s[2] / square
    for i in range(3):
        out[i] = s[VELOCITY + i]
    level = rate * rate - pull - bulge * (1.0 - tilt)
    out[VELOCITY] = level * s[0] + 2.0 * rate * s[VELOCITY + 1] + a[0]
    out[VELOCITY + 1] = level * s[1] - 2.0 * rate * s[VELOCITY] + a[1]
    out[VELOCITY + 2] = -(pull + bulge * (3.0 - tilt)) * s[2] + a[2]


@compiled
def propagate_state(vector: Vector, t_s: float, out: Vector) -> None:
    """Propagate a state vector (9,) of r, v, luni-solar a by `t_s` seconds; writes r, v to
    `out`."""
    steps = int(np.ceil(abs(t_s) / STEP_S))
    for i in range(6):
        out[i] = vector[i]
    if steps == 0:
        return
    dt = t_s / steps
    k, trial, total = np.empty(6), np.empty(6), np.empty(6)
    for _ in range(steps):
        for i in range(6):
            trial[i], total[i] = out[i], 0.0
        for stage in range(4):
            _state_derivative(trial, vector[6:9], k)
            share = 2.0 if stage == 1 or stage == 2 else 1.0
            reach = dt if stage == 2 else 0.5 * dt
            for i in range(6):
                total[i] += share * k[i]
                trial[i] = out[i] + reach * k[i]
        for i in range(6):
            out[i] += dt / 6.0 * total[i]
