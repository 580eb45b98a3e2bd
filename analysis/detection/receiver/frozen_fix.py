"""A receiver that repeats its fix while it hovers, told by its own past.

Place and velocity of a receiver at rest still differ from fix to fix by its noise. One that has
never repeated itself for long does not begin to; one that has may hold still as it likes.
"""

from typing import ClassVar, NamedTuple

from analysis.detection.detector_registry import BlockDetector
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import FIX, Block
from analysis.samples.sample import GpsFix

FIX_3D, OWN_SOURCE = 3, "HIL_GPS"
LEARNED_FIXES = 100  # fixes after which it is known
# Repetitions beyond the most so far; one that ever held still so long (a simulator's) may
RUN_FACTOR, RUN_MORE, STILL_FIXES = 3, 10, 3
CONFIRM_US, REPEAT_US = 500_000, 500_000


class FixRepeats(NamedTuple):
    """The newest fix, since when it is repeated, how often, and how often at most before; and
    how many came."""

    fix: tuple[float, ...] = ()
    t_us: int = -1
    since_us: int = 0
    run: int = 0
    longest: int = 0
    fix_count: int = 0

    def updated(self, t_us: int, fix: tuple[float, ...]) -> "FixRepeats":
        """With one fix more."""
        if t_us <= self.t_us:  # the same message once more, or another clock
            return self._replace(t_us=t_us)
        new = self._replace(fix=fix, t_us=t_us, fix_count=self.fix_count + 1)
        known = self.fix_count >= LEARNED_FIXES
        if fix == self.fix:
            longest = self.longest if known else max(self.longest, self.run + 1)
            return new._replace(run=self.run + 1, longest=longest)
        # What was a fault is no habit.
        habit = self.run if self.run <= RUN_FACTOR * self.longest + RUN_MORE or not known else 0
        return new._replace(run=0, since_us=t_us, longest=max(self.longest, habit))

    @property
    def frozen(self) -> bool:
        """Whether it repeats itself as it never did."""
        most = RUN_FACTOR * self.longest + RUN_MORE
        lasts = self.t_us - self.since_us >= CONFIRM_US
        return (
            self.fix_count >= LEARNED_FIXES
            and self.longest <= STILL_FIXES
            and self.run > most
            and lasts
        )


def fix_values(fix: GpsFix) -> tuple[float, ...]:
    """Place and level velocity of a fix."""
    level = (0.0, 0.0) if fix.v_ned_mps is None else tuple(fix.v_ned_mps[:2].tolist())
    return fix.lat_deg, fix.lon_deg, fix.alt_m, *level


class FrozenFixState(NamedTuple):
    """The receiver that is followed, by the message it came in, and when it was told of last."""

    repeats: FixRepeats = FixRepeats()
    source: str | None = None
    reported_us: int = 0


class FrozenFixDetector(BlockDetector, frozen=True):
    """A step of the pipeline."""

    channels: ClassVar = frozenset({"gps-position"})

    def new_state(self) -> FrozenFixState:
        """Nothing came yet."""
        return FrozenFixState()

    def step(
        self, block: Block, state: FrozenFixState
    ) -> tuple[list[tuple[int, SensorDecision]], FrozenFixState]:
        """Where the receiver repeats itself, by the row that shows it, and the next state."""
        found = []
        for row in block.rows(FIX).tolist():
            fix = block.sample(row)
            assert isinstance(fix, GpsFix)
            # What an autopilot passes on is no second witness.
            if state.source not in (None, fix.source) and fix.source != OWN_SOURCE:
                continue
            if fix.fix_type < FIX_3D:
                continue
            repeats = state.repeats if fix.source == state.source else FixRepeats()
            repeats = repeats.updated(fix.t_us, fix_values(fix))
            state = FrozenFixState(repeats, fix.source, state.reported_us)
            if repeats.frozen and fix.t_us - state.reported_us >= REPEAT_US:
                state = state._replace(reported_us=fix.t_us)
                found.append((row, _result(fix.t_us, (fix.t_us - repeats.since_us) * 1e-6)))
        return found, state


def _result(t_us: int, for_s: float) -> SensorDecision:
    return pattern_alarm(
        t_us,
        "gps-position",
        f"the same fix for {for_s:.1f} s",
    )
