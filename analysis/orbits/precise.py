"""Precise orbits and clocks as polynomials about nodes five minutes apart.

A polynomial through the eleven nearest positions of a table [1]_ gives position, velocity and
derivatives at a node; the first five terms are within 1 cm of it until the next node is nearer. The
clock is linear between the table's values, with the periodic effect of relativity [2]_, which
tables leave out.

References
----------
.. [1] M. Schenewerk, A brief review of basic GPS orbit interpolation strategies, GPS Solutions 6,
   2003.
.. [2] IS-GPS-200N, 20.3.3.3.3.1.
"""

from collections.abc import Iterator

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from analysis.samples.sample import PreciseOrbit, Vector
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.gps_clock import normalized

NODE_S = 2.0 * PreciseOrbit.fit_half_s
POINTS, TERMS = 11, 5
MOST_SPACING_S = 900.0  # of a table: 15 minutes is the longest that is published


def precise_orbits(
    name: str, orbit: Vector, clock: Vector, group_delay_s: float, begin_s: float, end_s: float
) -> Iterator[PreciseOrbit]:
    """The polynomials of a satellite from `begin_s` to `end_s`, where its tables cover them.

    `orbit` (n, 4) and `clock` (m, 2) are its tables: seconds of GPS time, ECEF position in m, or
    clock offset in s.
    """
    if len(orbit) < POINTS or not len(clock):
        return
    for node_s in np.arange(begin_s // NODE_S * NODE_S, end_s + NODE_S, NODE_S).tolist():
        first = int(np.searchsorted(orbit[:, 0], node_s)) - POINTS // 2
        near = orbit[min(max(first, 0), len(orbit) - POINTS) :][:POINTS]
        t_s = near[:, 0] - node_s
        clock_s = clock[:, 0] - node_s
        at = min(int(np.searchsorted(clock_s, 0.0, "right")), len(clock_s) - 1)
        gaps_s = np.append(np.diff(t_s), np.diff(clock_s[max(at - 1, 0) : at + 1]))
        covered = all(some[0] <= 0.0 <= some[-1] for some in (t_s, clock_s))
        if not covered or gaps_s.max() > MOST_SPACING_S:
            continue
        scale_s = t_s[-1] - t_s[0]
        powers = np.vander(t_s / scale_s, increasing=True)
        terms = np.linalg.solve(powers, near[:, 1:])[:TERMS]
        terms /= scale_s ** np.arange(TERMS)[:, None]
        # At the ends of the table only one side of a node is known.
        at_s = np.clip([-NODE_S / 2.0, 0.0, NODE_S / 2.0], clock_s[0], clock_s[-1])
        r_v = (polyval(at_s, terms) * polyval(at_s, polyder(terms))).sum(axis=0)
        offset_s = np.interp(at_s, clock_s, clock[:, 1]) - 2.0 * r_v / SPEED_OF_LIGHT_MPS**2
        rate = (offset_s[2] - offset_s[0]) / (at_s[2] - at_s[0]) if at_s[2] > at_s[0] else 0.0
        week, toe_s = normalized(0, node_s)
        numbers = tuple(terms.ravel().tolist())
        af0_s, af1 = float(offset_s[1]), float(rate)
        yield PreciseOrbit(name, week, toe_s, numbers, af0_s, af1, group_delay_s)
