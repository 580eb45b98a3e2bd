"""Averages samples over time bins of 0.1 s: mean motion and the terms that predict it.

The mean rates of two adjacent bins differ by the angular acceleration, weighted by a triangle;
commands, behind their actuator's lag, rates and specific force have the same weights.
"""

from dataclasses import dataclass, field

import numpy as np

from analysis.detection.actuators.effects import COMMANDS
from analysis.samples.sample import Vector

BIN_US = 100_000  # 2.5 lags of a motor (40 ms): its response is 92 % complete
NEVER_BIN = -(1 << 40)  # no bin's number

# Of `sums`: samples, their times in the bin, rates, specific force, lagged commands, airspeed
COUNT, TIME, RATES, FORCES, LAGGED = 0, 1, 2, 5, 8
AIR, WIDTH = LAGGED + COMMANDS, LAGGED + COMMANDS + 1  # the last, and how many
AIR_LASTS_US = 300_000  # validity of an airspeed: three intervals at 10 Hz


@dataclass(slots=True)
class MotionBins:
    """The bin that is being filled, and the one before.

    `lags_s` (COMMANDS,) of the actuators; `newer` and `older` (2, WIDTH) are the sums of the two
    bins: plain, and weighted by the time in the bin, which rises from 0 to 1.
    """

    lags_s: Vector
    number: int = NEVER_BIN
    sample_us: int = 0  # the newest
    has_previous: bool = False  # whether the bin before it is full
    commands: Vector = field(default_factory=lambda: np.zeros(COMMANDS))
    lagged: Vector = field(default_factory=lambda: np.zeros(COMMANDS))
    air_mps: float = 0.0
    air_until_us: int = 0
    newer: Vector = field(default_factory=lambda: np.zeros((2, WIDTH)))
    older: Vector = field(default_factory=lambda: np.zeros((2, WIDTH)))

    def add_imu_sample(self, t_us: int, rates_force: Vector) -> tuple[Vector, Vector] | None:
        """Add an IMU sample, rates and specific force (6,); the terms (TERMS,) and motion (AXES,)
        of the last two bins if it is the first of a new one."""
        number, ready = t_us // BIN_US, None
        if number != self.number:
            if number == self.number + 1:
                ready = self._average_motion() if self.has_previous else None
                self.has_previous = True
            else:  # a gap, or the first sample
                self.has_previous = False
                self.lagged = self.commands.copy()
            self.number = number
            self.older, self.newer = self.newer, np.zeros((2, WIDTH))
        elif t_us > self.sample_us:
            # Without a lag the exponent is infinite.
            with np.errstate(divide="ignore"):
                share = 1.0 - np.exp((self.sample_us - t_us) * 1e-6 / self.lags_s)
            self.lagged += share * (self.commands - self.lagged)
        self.sample_us = t_us
        at = (t_us - number * BIN_US) / BIN_US
        row = np.concatenate([(1.0, at), rates_force, self.lagged, (self.air_mps,)])
        self.newer[0] += row
        self.newer[1] += at * row
        return ready

    def _average_motion(self) -> tuple[Vector, Vector] | None:
        """Terms and motion of the two bins, the second of which is full."""
        newer, older = self.newer, self.older
        # The weight rises over the older bin and falls over the newer one.
        mean = older[1] + newer[0] - newer[1]
        if newer[0, COUNT] == 0.0 or older[0, COUNT] == 0.0 or mean[COUNT] <= 0.0:
            return None
        mean = mean / mean[COUNT]
        step = newer[0] / newer[0, COUNT] - older[0] / older[0, COUNT]
        turn = step[RATES:FORCES] / ((1.0 + step[TIME]) * BIN_US * 1e-6)
        forward, right, down = mean[FORCES:LAGGED]
        # Without an airspeed its term is 0.
        air = mean[AIR] if self.sample_us < self.air_until_us else 0.0
        terms = np.array([1.0, *mean[LAGGED:AIR], *mean[RATES:FORCES], right, down, air])
        return terms, np.array([*turn, forward, forward, down])
