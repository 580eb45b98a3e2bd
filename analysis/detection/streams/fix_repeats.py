"""Recognizes a receiver that repeats its fix, from its own past.

Position and velocity of a receiver at rest still differ from fix to fix by its noise. A receiver
that has never repeated itself does not begin to; one that has is exempt.
"""

import math
from typing import NamedTuple

from analysis.samples.sample import GpsFix

# Before the first test: one that repeats every 20th fix has shown it five times.
LEARNED_FIXES = 100
# Repetitions beyond the most so far, and for how long; a receiver that ever repeated more than
# STILL_FIXES (a simulator's) is exempt.
RUN_FACTOR, RUN_MORE, RUN_US, STILL_FIXES = 3, 10, 500_000, 3
# While it moves a receiver repeats nothing: at 1 m/s and 5 Hz a fix is 0.2 m on, its digit 1 cm.
MOVING_MPS, MOVING_FIXES = 1.0, 5


class FixRepeats(NamedTuple):
    """The newest fix, since when and how often it is repeated, the most before; number of fixes."""

    fix: tuple[float, ...] = ()
    t_us: int = -1
    since_us: int = 0
    run: int = 0
    longest: int = 0
    fix_count: int = 0

    def updated(self, t_us: int, fix: tuple[float, ...]) -> "FixRepeats":
        """With one more fix."""
        if t_us <= self.t_us:  # the same message again, or another clock
            return self._replace(t_us=t_us)
        new = self._replace(fix=fix, t_us=t_us, fix_count=self.fix_count + 1)
        known = self.fix_count >= LEARNED_FIXES
        if fix == self.fix:
            longest = self.longest if known else max(self.longest, self.run + 1)
            return new._replace(run=self.run + 1, longest=longest)
        # A fault's repetitions are not legitimate.
        legitimate_run = (
            self.run if self.run <= RUN_FACTOR * self.longest + RUN_MORE or not known else 0
        )
        return new._replace(run=0, since_us=t_us, longest=max(self.longest, legitimate_run))

    @property
    def frozen(self) -> bool:
        """Whether it repeats itself as it never did before."""
        if self.t_us - self.since_us < RUN_US:
            return False
        if math.hypot(*self.fix[3:]) > MOVING_MPS and self.run >= MOVING_FIXES:
            return True
        known = self.fix_count >= LEARNED_FIXES and self.longest <= STILL_FIXES
        return known and self.run > RUN_FACTOR * self.longest + RUN_MORE


def fix_values(fix: GpsFix) -> tuple[float, ...]:
    """Position and level velocity of a fix."""
    level = (0.0, 0.0) if fix.v_ned_mps is None else tuple(fix.v_ned_mps[:2].tolist())
    return fix.lat_deg, fix.lon_deg, fix.alt_m, *level
