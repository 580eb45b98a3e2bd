"""What an attitude estimator is: readings in, an attitude out.

An estimator is a frozen set of parameters; what moves is the state it hands back. Readings are the
samples of `analysis.samples.sample`; one that an estimator has no use for changes nothing.
Attitudes are unit quaternions (w, x, y, z) that take body axes (forward, right, down) to north,
east, down.
"""

from dataclasses import dataclass, field
from math import sqrt
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import ATTITUDE, IMU, TRUTH, Block, Indices, Stamps
from analysis.samples.sample import Sample
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

Vector = NDArray[np.float64]
MAX_GAP_S = 0.5  # a longer pause between IMU samples is not integrated over


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known at the start: q_nb (4,), velocity over ground (3,), position (3,), declination.

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
    """The contract; `state` is whatever `start` returned.

    One that can take many samples at once, compiled, also has a method `follow(block, state)`: see
    the function below.
    """

    def start(self, prior: Prior) -> Any:
        """The state before the first reading."""

    def update(self, reading: Sample, state: Any) -> tuple[AttitudeEstimate, Any]:
        """The attitude after one reading, and the next state."""


def estimate_block(estimator: Estimator, block: Block, state: Any) -> tuple[Stamps, Vector, Any]:
    """Estimates of a block, stamps (m,) and q_nb (m, 4) at its m IMU samples; the next state."""
    at_once = getattr(estimator, "follow", None)
    # A compiled estimator takes the block at once; any other sample by sample.
    if at_once is not None:
        found: tuple[Stamps, Vector, Any] = at_once(block, state)
        return found
    stamps, attitudes = [], []
    for row, kind in enumerate(block.kind.tolist()):
        # Truth is for the scores, and another's attitude is no measurement.
        if kind not in (TRUTH, ATTITUDE):
            estimate, state = estimator.update(block.sample(row), state)
            if kind == IMU:
                stamps.append(estimate.t_us)
                attitudes.append(estimate.q_nb)
    return np.array(stamps, np.int64), np.array(attitudes, dtype=float).reshape(-1, 4), state


@compiled
def empty_estimates(kind: Indices) -> tuple[Stamps, Vector]:
    """Stamps (m,) and q_nb (m, 4), to be filled, of the m IMU samples among some kinds."""
    count = 0
    for i in range(len(kind)):
        count += kind[i] == IMU
    return np.empty(count, np.int64), np.empty((count, 4))


@compiled
def airspeed_mps(diff_pressure_pa: float) -> float:
    """Equivalent airspeed from the pitot tube's pressure; 0 where it is negative."""
    # A pitot tube reads below zero in still air by its noise.
    return sqrt(2.0 * max(diff_pressure_pa, 0.0) / SEA_LEVEL_DENSITY_KGPM3)
