"""The flight envelope: which limit a truth violates."""

from math import asin, atan2, degrees, inf, sqrt

import numpy as np

from analysis.search.space.test_file import FlightEnvelope
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

LIMITS = ("", "pitch", "alpha", "beta", "airspeed", "rate", "load", "ground")


def pack_envelope(limits: FlightEnvelope, hovers: bool) -> Array:
    """The limits (8,) of `violated_limit`; airspeed and flow angles have none if it `hovers`."""
    of_wings = (limits.alpha_deg, limits.beta_deg, *limits.airspeed_mps)
    return np.array(
        [
            limits.pitch_deg,
            *((inf, inf, -inf, inf) if hovers else of_wings),
            limits.rate_dps,
            limits.load_g * STANDARD_GRAVITY_MPS2,
            limits.height_m,
        ]
    )


@inlined
def _length(vector: Array) -> float:
    x, y, z = vector[0], vector[1], vector[2]
    return sqrt(x * x + y * y + z * z)


@compiled
def violated_limit(
    q_nb: Array, v_air_b_mps: Array, omega_b_rps: Array, force_b_mps2: Array, height_m: float,
    limits: Array,
) -> int:  # fmt: skip
    """Index into LIMITS of the first limit that a truth violates, 0 within the envelope."""
    u, v, w = v_air_b_mps[0], v_air_b_mps[1], v_air_b_mps[2]
    sine = min(1.0, max(-1.0, 2.0 * (q_nb[0] * q_nb[2] - q_nb[3] * q_nb[1])))
    speed = _length(v_air_b_mps)
    if abs(degrees(asin(sine))) > limits[0]:
        return 1
    if abs(degrees(atan2(w, u))) > limits[1]:
        return 2
    if degrees(atan2(abs(v), sqrt(u * u + w * w))) > limits[2]:
        return 3
    if speed < limits[3] or speed > limits[4]:
        return 4
    if degrees(_length(omega_b_rps)) > limits[5]:
        return 5
    if _length(force_b_mps2) > limits[6]:
        return 6
    return 7 if height_m <= limits[7] else 0
