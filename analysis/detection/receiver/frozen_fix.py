"""Detects a receiver that repeats its fix while it hovers, from its own past.

Position and velocity of a receiver at rest still differ from fix to fix by its noise. A receiver
that has never repeated itself does not begin to; one that has is exempt.
"""

from typing import ClassVar, NamedTuple

from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import FIX, FIX_3D, Block
from analysis.samples.sample import GpsFix

OWN_SOURCE = "HIL_GPS"
LEARNED_FIXES = 100  # fixes before the first test, chosen
# Repetitions beyond the most so far; a receiver that ever repeated more (a simulator's) is exempt.
RUN_FACTOR, RUN_MORE, STILL_FIXES = 3, 10, 3
CONFIRM_US, REPEAT_US = 500_000, 500_000


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
        most = RUN_FACTOR * self.longest + RUN_MORE
        lasts = self.t_us - self.since_us >= CONFIRM_US
        return (
            self.fix_count >= LEARNED_FIXES
            and self.longest <= STILL_FIXES
            and self.run > most
            and lasts
        )


def fix_values(fix: GpsFix) -> tuple[float, ...]:
    """Position and level velocity of a fix."""
    level = (0.0, 0.0) if fix.v_ned_mps is None else tuple(fix.v_ned_mps[:2].tolist())
    return fix.lat_deg, fix.lon_deg, fix.alt_m, *level


class FrozenFixState(NamedTuple):
    """The tested receiver, the message it comes in, and when it was reported last."""

    repeats: FixRepeats = FixRepeats()
    source: str | None = None
    reported_us: int = 0


class FrozenFixDetector(BlockDetector, frozen=True):
    """Counts repetitions of a receiver's fix."""

    channels: ClassVar = frozenset({"gps-position"})
    state: ClassVar = FrozenFixState

    def step(self, block: Block, state: FrozenFixState) -> tuple[RowResults, FrozenFixState]:
        """The alarms of the next samples, each with its row, and the next state."""
        results = []
        for row in block.rows(FIX).tolist():
            fix = block.sample(row)
            assert isinstance(fix, GpsFix)
            # A fix that an autopilot forwards is not independent.
            if state.source not in (None, fix.source) and fix.source != OWN_SOURCE:
                continue
            if fix.fix_type < FIX_3D:
                continue
            repeats = state.repeats if fix.source == state.source else FixRepeats()
            repeats = repeats.updated(fix.t_us, fix_values(fix))
            state = FrozenFixState(repeats, fix.source, state.reported_us)
            if repeats.frozen and fix.t_us - state.reported_us >= REPEAT_US:
                state = state._replace(reported_us=fix.t_us)
                results.append((row, _result(fix.t_us, (fix.t_us - repeats.since_us) * 1e-6)))
        return results, state


def _result(t_us: int, for_s: float) -> SensorDecision:
    return pattern_alarm(t_us, "gps-position", f"the same fix for {for_s:.1f} s")
