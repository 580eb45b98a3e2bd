"""The flight envelope: which limit a truth violates."""

import numpy as np
from numpy.typing import NDArray

from analysis.search.space.test_file import FlightEnvelope
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from simvehicle.vehicles.body import Truth

Array = NDArray[np.float64]
# Attitude (n, 4), velocity through the air, rates and specific force (n, 3) in body axes, and
# height above ground (n,).
Motion = tuple[Array, Array, Array, Array, Array]
LIMITS = ("", "pitch", "alpha", "beta", "airspeed", "rate", "load", "ground")


def violated_limits(motion: Motion, limits: FlightEnvelope, hovers: bool) -> NDArray[np.int64]:
    """Indices (n,) into LIMITS of truths, 0 within the envelope.

    If it `hovers`, airspeed and flow angles are not limited.
    """
    q_nb, v_air_b_mps, omega_b_rps, force_b_mps2, height_m = motion
    u, v, w = v_air_b_mps.T
    e0, e1, e2, e3 = q_nb.T
    sine = np.clip(2.0 * (e0 * e2 - e3 * e1), -1.0, 1.0)
    speed = np.linalg.norm(v_air_b_mps, axis=1)
    low, high = limits.airspeed_mps
    of_wings = np.full(len(u), not hovers)
    violated = [
        np.abs(np.degrees(np.arcsin(sine))) > limits.pitch_deg,
        of_wings & (np.abs(np.degrees(np.arctan2(w, u))) > limits.alpha_deg),
        of_wings & (np.degrees(np.arctan2(np.abs(v), np.hypot(u, w))) > limits.beta_deg),
        of_wings & ((speed < low) | (speed > high)),
        np.degrees(np.linalg.norm(omega_b_rps, axis=1)) > limits.rate_dps,
        np.linalg.norm(force_b_mps2, axis=1) > limits.load_g * STANDARD_GRAVITY_MPS2,
        height_m <= limits.height_m,
    ]
    return np.select(violated, range(1, len(LIMITS)), 0)


def violated_limit(truth: Truth, limits: FlightEnvelope, hovers: bool) -> int:
    """The index into LIMITS of one truth."""
    motion = (
        truth.q_nb[None], truth.v_air_b_mps[None], truth.omega_b_rps[None],
        truth.specific_force_b_mps2[None], np.array([truth.height_agl_m]),
    )  # fmt: skip
    return int(violated_limits(motion, limits, hovers)[0])
