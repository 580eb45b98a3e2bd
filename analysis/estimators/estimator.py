"""The interface of attitude estimators: readings in, attitude out.

An estimator holds fixed parameters; its state is passed in and returned. Readings are the samples
of `analysis.samples.sample`; an estimator ignores those it does not use. Attitudes are unit
quaternions (w, x, y, z) that take body axes (forward, right, down) to north, east, down.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from analysis.samples.block import ATTITUDE, IMU, TRUTH, Block, Indices, Stamps, block_of
from analysis.samples.sample import Sample, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

MAX_GAP_S = 0.5  # longer gaps are not integrated: at 1 rad/s they hide 30 degrees


@dataclass(frozen=True, slots=True)
class Prior:
    """Initial q_nb (4,), velocity over ground (3,), position (3,) and magnetic declination.

    `declination_rad` is the magnetic declination of the place, positive to the east.
    """

    t_us: int
    q_nb: Vector
    v_ned_mps: Vector = field(default_factory=lambda: np.zeros(3))
    r_ned_m: Vector = field(default_factory=lambda: np.zeros(3))
    declination_rad: float = 0.0


@dataclass(slots=True)
class AttitudeEstimate:
    """The attitude at one instant; not frozen only because that would cost a microsecond each."""

    t_us: int
    q_nb: Vector


class Estimator(Protocol):
    """The contract; `state` is what `start` returned.

    An optional method `update_block(block, state)` processes many samples at once and returns what
    `estimate_block` does.
    """

    def start(self, prior: Prior) -> Any:
        """The state before the first reading."""

    def update(self, reading: Sample, state: Any) -> tuple[AttitudeEstimate, Any]:
        """The attitude after one reading, and the next state."""


def estimate_block(estimator: Estimator, block: Block, state: Any) -> tuple[Stamps, Vector, Any]:
    """Run an estimator over a block: stamps (m,), q_nb (m, 4) at its m IMU samples, next state."""
    update_block = getattr(estimator, "update_block", None)
    # A compiled estimator processes the block at once; any other sample by sample.
    if update_block is not None:
        estimates: tuple[Stamps, Vector, Any] = update_block(block, state)
        return estimates
    stamps, attitudes = [], []
    for row, kind in enumerate(block.kind.tolist()):
        # Truth is for scoring, and another estimator's attitude is no measurement.
        if kind not in (TRUTH, ATTITUDE):
            estimate, state = estimator.update(block.sample(row), state)
            if kind == IMU:
                stamps.append(estimate.t_us)
                attitudes.append(estimate.q_nb)
    return np.array(stamps, np.int64), np.array(attitudes, dtype=float).reshape(-1, 4), state


class KernelState(NamedTuple):
    """State of a compiled estimator: x begins with q_nb (4,), `stamps` with the time of the state,
    then come airspeed and magnetic declination."""

    x: Vector
    stamps: Stamps
    airspeed_mps: float
    declination_rad: float


class KernelEstimator:
    """A compiled estimator: `filter_block` runs over a block's columns with a `tuning`."""

    filter_block: ClassVar[Callable[..., tuple[Stamps, Vector, KernelState]]]
    tuning: Any

    def update(self, reading: Sample, state: KernelState) -> tuple[AttitudeEstimate, KernelState]:
        """The attitude after one reading, and the next state."""
        _, _, state = self.update_block(block_of(reading), state)
        return AttitudeEstimate(int(state.stamps[0]), state.x[:4]), state

    def update_block(self, block: Block, state: KernelState) -> tuple[Stamps, Vector, KernelState]:
        """Update with a block: stamps (m,) and q_nb (m, 4) after each IMU sample, next state."""
        # A column of a table would be another type, for which all is compiled again.
        kind, t_us = np.ascontiguousarray(block.kind), np.ascontiguousarray(block.t_us)
        return self.filter_block(kind, t_us, block.values, state, self.tuning)


@compiled
def empty_estimates(kind: Indices) -> tuple[Stamps, Vector]:
    """Empty stamps (m,) and q_nb (m, 4) for the m IMU samples among `kind` (n,)."""
    count = 0
    for i in range(len(kind)):
        count += kind[i] == IMU
    return np.empty(count, np.int64), np.empty((count, 4))


@compiled
def airspeed_mps(diff_pressure_pa: float) -> float:
    """Equivalent airspeed from the pitot tube's pressure; 0 where it is negative."""
    # A pitot tube reads below zero in still air by its noise.
    return sqrt(2.0 * max(diff_pressure_pa, 0.0) / SEA_LEVEL_DENSITY_KGPM3)
