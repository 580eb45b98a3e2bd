"""Protection levels: how far the position may be off at a stated integrity risk.

By solution separation, as in advanced RAIM [1]_, about the detector's own position: whichever
satellite, or whole system, may be faulty without having been found, the snapshot that does not use
it bounds the truth. With d_k the distance from the position to that snapshot and sigma_k what the
snapshot may be wrong by without a fault,

    level = max over k of |d_k| + K_k sigma_k,   Q(K_k) = risk / (3 axes, hypotheses, prior of k)

No sigma of the filter is in it. A hypothesis without enough satellites left makes the level
unknown; the fault of the only system in use cannot be seen and is not covered.

References
----------
.. [1] Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51(1), 2015.
.. [2] RTCA DO-229D, A.4.2.5 (troposphere), J.2.3 (ionosphere by Klobuchar's model).
"""

import math

import numpy as np

from analysis.detection.detection_config import DetectorConfig, SigmaNumbers
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.measurement import Measured, modelled_at, states_at
from analysis.detection.isolation.chi_square import two_sided
from analysis.orbits.broadcast import AZIMUTH, SYSTEMS, klobuchar_m, predict_ranges
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.earth_kernel import geodetic, ned_axes
from mavproxy_fault.numerics.linear import inverse

RISK = 1e-7  # per epoch, of an error beyond a level without a word
SATELLITE_PRIOR, SYSTEM_PRIOR = 1e-5, 1e-4  # of a fault that nobody has announced [1]_
SIGNAL_M, TROPOSPHERE_M = 1.0, 0.12  # sigmas of orbit and clock [1]_, of the zenith delay [2]_
VERTICAL_M = 4.5, 6.0, 9.0  # of the ionosphere at 20 to 55 degrees, above, and below [2]_
AXES = 3
UNSEEN = (
    1e-9  # keeps the clock of a system without satellites from making the normal matrix singular
)
WORST_M = 1e4  # a level beyond it is none


def protection_levels(
    measured: Measured, r_ecef_m: Vector, ionosphere: Vector, config: DetectorConfig
) -> tuple[float | None, float | None]:
    """Horizontal and vertical protection level in m of a position (3,) from the satellites in use.

    None where a fault that may be there could not be seen by the others.
    """
    systems = len(np.unique(measured.system))
    hypotheses = 1 + len(measured.system) + (systems if systems > 1 else 0)
    share = RISK / (AXES * hypotheses)
    factors = np.array(
        [two_sided(min(share / prior, 1.0)) for prior in (1.0, SATELLITE_PRIOR, SYSTEM_PRIOR)]
    )
    slow2 = 1.0 + config.sigma.slow**2
    levels = _levels(measured, r_ecef_m, ionosphere, config.sigma.numbers, slow2, factors)
    horizontal_m, vertical_m = levels.tolist()
    return (
        round(horizontal_m, 3) if horizontal_m < WORST_M else None,
        round(vertical_m, 3) if vertical_m < WORST_M else None,
    )


@compiled
def _levels(
    measured: Measured,
    r_ecef_m: Vector,
    ionosphere: Vector,
    sigma: SigmaNumbers,
    slow2: float,
    factors: Vector,
) -> Vector:
    """Horizontal and vertical level (2,); infinite where a hypothesis cannot be tested."""
    rows, weight, v = _rows(measured, r_ecef_m, ionosphere, sigma, slow2)
    count, most = weight.shape[0], np.zeros(AXES)
    used = np.zeros(len(SYSTEMS), np.int64)
    for i in range(count):
        used[measured.system[i]] += 1
    several = np.sum(used > 0) > 1
    for k in range(-1, count + len(SYSTEMS)):
        system = k - count
        if system >= 0 and (used[system] == 0 or not several):
            continue
        keep = weight.copy()
        for i in range(count):
            if i == k or measured.system[i] == system:
                keep[i] = 0.0
        factor = factors[0] if k < 0 else factors[1] if system < 0 else factors[2]
        off, spread = _snapshot(rows, keep, v)
        for q in range(AXES):
            most[q] = max(most[q], abs(off[q]) + factor * spread[q])
    return np.array([math.hypot(most[0], most[1]), most[2]])


@compiled
def _snapshot(rows: Vector, weight: Vector, v: Vector) -> tuple[Vector, Vector]:
    """Shift (3,) north, east, down of the snapshot of those with a weight (n,), and its sigmas."""
    size = rows.shape[1]
    normal, b = np.zeros((size, size)), np.zeros(size)
    clocks = np.zeros(size)
    remaining = 0
    for i in range(rows.shape[0]):
        remaining += weight[i] > 0.0
        for k in range(size):
            b[k] += weight[i] * rows[i, k] * v[i]
            clocks[k] += weight[i] * abs(rows[i, k])
            for j in range(size):
                normal[k, j] += weight[i] * rows[i, k] * rows[i, j]
    unknowns = AXES
    for k in range(AXES, size):
        unknowns += clocks[k] > 0.0
        normal[k, k] += UNSEEN
    off, spread = np.zeros(AXES), np.full(AXES, np.inf)
    if remaining < unknowns:
        return off, spread
    cofactor = inverse(normal)
    for q in range(AXES):
        if math.isfinite(cofactor[q, q]) and cofactor[q, q] < WORST_M**2:
            spread[q] = math.sqrt(cofactor[q, q])
            for j in range(size):
                off[q] += cofactor[q, j] * b[j]
    return off, spread


@compiled
def _rows(
    measured: Measured, r_ecef_m: Vector, ionosphere: Vector, sigma: SigmaNumbers, slow2: float
) -> tuple[Vector, Vector, Vector]:
    """Geometry (n, 7) by north, east, down and a clock per system, weights and residuals (n,)."""
    x = np.zeros(X_SIZE)
    for k in range(AXES):
        x[k] = r_ecef_m[k]
    states = states_at(measured)
    modelled = modelled_at(measured, states, x, ionosphere, sigma)
    predicted = predict_ranges(states, x[0:3], x[3:6], measured.tow_s, ionosphere)
    lat, lon, _ = geodetic(r_ecef_m)
    axes = ned_axes(lat, lon)
    away = abs(math.degrees(lat))
    zenith_m = VERTICAL_M[2] if away < 20.0 else VERTICAL_M[0] if away < 55.0 else VERTICAL_M[1]
    count = states.shape[0]
    rows, weight, first = np.zeros((count, AXES + len(SYSTEMS))), np.empty(count), modelled.v_m[0]
    v = np.empty(count)
    for i in range(count):
        for k in range(AXES):
            for j in range(AXES):
                rows[i, k] += axes[k, j] * modelled.h[i, j]
        rows[i, AXES + measured.system[i]] = 1.0
        el = modelled.elevation_rad[i]
        slant = 1.0 / math.sqrt(1.0 - (6378.1363 * math.cos(el) / (6378.1363 + 350.0)) ** 2)
        delay_m = klobuchar_m(lat, lon, predicted[i, AZIMUTH], el, measured.tow_s, ionosphere)
        bent_m = max(delay_m / 5.0, slant * zenith_m)
        wet_m = TROPOSPHERE_M * 1.001 / math.sqrt(0.002001 + math.sin(el) ** 2)
        variance = slow2 * modelled.variance[i] + bent_m**2 + wet_m**2 + SIGNAL_M**2
        weight[i] = 1.0 / variance
        v[i] = modelled.v_m[i] - first  # the receiver's clock may be milliseconds off
    return rows, weight, v
