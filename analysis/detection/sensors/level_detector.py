"""Detects sensors that leave their own level, without filter and attitude: the size of the magnetic
field, whichever way the vehicle points, and whether a receiver reports a fix (docs/watches.md).
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

from analysis.detection.compass.compass_samples import ZERO, Axis, compass_samples
from analysis.detection.detector_registry import REPEAT_US, USUAL_US, BlockDetector, RowResults
from analysis.detection.streams.stream_times import FIX_SOURCE, accepts_source
from analysis.results import pattern_alarm
from analysis.samples.block import FIX_3D, FIX_TYPE, IMU, MAG, NEVER_US, Block

# A compass averages since its last sample, at most so long; a turn of 0.5 rad reduces it by 1 %
MEAN_US, TURN_RAD = 200_000, 0.5
# Of the short mean about the long one (p 1e-15; its errors last): with twice as many `mag-scale` is
# missed, as with twice SHORT_S.
CHANGE_SIGMAS = 8.0
# Memories, and the age of a level that is tested: with 8 s the presets, which begin at 6 s, are
# missed (benchmarks/preset_table.py).
SHORT_S, LONG_S, LEARNED_S = 0.3, 30.0, 4.0
GAP_US = 1_000_000  # gap after which a level is learned again


@dataclass(slots=True)
class SensorLevel:
    """The means of a quantity, the level before, and the smallest changes of it up and down."""

    up: float
    down: float
    short: float = 0.0
    long: float = 0.0
    square: float = 0.0
    previous: float = math.nan
    began_us: int = NEVER_US
    newest_us: int = NEVER_US
    off_since_us: int = NEVER_US
    reported_us: int = NEVER_US

    def change(self, t_us: int, value: float) -> float:
        """Add a value; the change if it is to be reported, else 0."""
        elapsed_s, self.newest_us = (t_us - self.newest_us) * 1e-6, t_us
        if not 0.0 <= elapsed_s <= GAP_US * 1e-6:
            self.short, self.long, self.square, self.previous = value, value, 0.0, math.nan
            self.began_us, self.off_since_us, self.reported_us = t_us, NEVER_US, NEVER_US
            return 0.0
        self.short += min(1.0, elapsed_s / SHORT_S) * (value - self.short)
        change, age_s = self.short - self.long, (t_us - self.began_us) * 1e-6
        least = self.up if change > 0.0 else self.down
        limit = max(least, CHANGE_SIGMAS * math.sqrt(self.square))
        if not (age_s > LEARNED_S and abs(change) > limit):
            self.off_since_us = NEVER_US
            # A young stream's long mean is over its age, as its first value alone is noise.
            share = min(1.0, elapsed_s / min(LONG_S, max(age_s, SHORT_S)))
            self.long += share * (value - self.long)
            self.square += share * (change * change - self.square)
        elif abs(self.short - self.previous) < limit:
            self.long, self.previous, self.off_since_us = self.previous, math.nan, NEVER_US
        else:
            self.off_since_us = t_us if self.off_since_us == NEVER_US else self.off_since_us
            since_us = t_us - self.off_since_us
            if since_us > USUAL_US:  # a lasting change is the new level
                self.previous, self.long, self.off_since_us = self.long, self.short, NEVER_US
            elif since_us >= SHORT_S * 1e6 and t_us - self.reported_us >= REPEAT_US:
                self.reported_us = t_us
                return change
        return 0.0


@dataclass(slots=True)
class LevelState:
    """The levels, the newest rates of turn, and the newest stamp of the compass."""

    # 0.05 gauss is 10 % of the Earth's field; a fix that returns is no fault.
    size: SensorLevel = field(default_factory=lambda: SensorLevel(0.05, 0.05))
    has_fix: SensorLevel = field(default_factory=lambda: SensorLevel(math.inf, 0.5))
    rates: Axis = ZERO
    field_us: int = NEVER_US
    source: float = math.nan  # of the fixes


class LevelDetector(BlockDetector, frozen=True):
    """Tests the field's size and the fix type."""

    channels: ClassVar = frozenset({"mag", "gps-position"})
    state: ClassVar = LevelState

    def step(self, block: Block, state: LevelState) -> tuple[RowResults, LevelState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        found = []
        for row, kind, t_us, values in compass_samples(block):
            x, y, z, *_ = values
            if kind == IMU:
                state.rates = x, y, z
            elif kind == MAG:
                mean_us = min(t_us - state.field_us, MEAN_US)
                state.field_us = t_us
                size, turned_rad = math.hypot(x, y, z), math.hypot(*state.rates) * mean_us * 1e-6
                usable = math.isfinite(size) and not turned_rad > TURN_RAD
                if usable and (change := state.size.change(t_us, size)):
                    reason = f"the magnetic field strength is off by {abs(change):.3f} gauss"
                    found.append((row, pattern_alarm(t_us, "mag", reason)))
            elif accepts_source(state.source, source := float(block.values[row, FIX_SOURCE])):
                # An autopilot's own report of the fix has another clock.
                state.source = source
                if state.has_fix.change(t_us, float(values[FIX_TYPE] >= FIX_3D)):
                    found.append((row, pattern_alarm(t_us, "gps-position", "reports no fix")))
        return found, state
