"""What an attitude estimator is: readings in, an attitude out.

An estimator is a frozen set of parameters; what moves is the state it hands back. Readings are the
samples of `analysis.epochs`; one that an estimator has no use for changes nothing. Attitudes are
unit quaternions (w, x, y, z) that take body axes (forward, right, down) to north, east, down.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.epochs import Sample

Vector = NDArray[np.float64]
GRAVITY_MPS2 = 9.80665  # standard gravity, CGPM 1901
SEA_LEVEL_DENSITY_KGPM3 = 1.225  # ISO 2533
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
    """The contract; `state` is whatever `start` returned."""

    def start(self, prior: Prior) -> Any:
        """The state before the first reading."""

    def update(self, reading: Sample, state: Any) -> tuple[AttitudeEstimate, Any]:
        """The attitude after one reading, and the next state."""


def airspeed_mps(diff_pressure_pa: float) -> float:
    """Equivalent airspeed from the pitot tube's pressure; 0 where it is negative."""
    return float((2.0 * max(diff_pressure_pa, 0.0) / SEA_LEVEL_DENSITY_KGPM3) ** 0.5)
