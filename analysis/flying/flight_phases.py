"""Find the beginning of each phase of a flight from the truth; faults can start at a phase."""

import numpy as np

from analysis.scoring.attitude_scores import PHASES, flight_phases
from simvehicle.vehicles.body import Truth

FIRST_PHASE_S = 5.0  # no phase counts before, since estimators need some seconds to settle
MIN_PHASE_S = 1.0  # chosen: a phase counts once it has lasted this long, not for a transient
AIRBORNE_M = 1.0  # chosen: from this height on the vehicle has taken off
LANDING_M = 10.0  # chosen: a descent below this height is a landing


class PhaseTracker:
    """Records the first time of each phase: hover, turn, climb, descent, level, landing."""

    def __init__(self) -> None:
        self.begin_s: dict[str, float] = {}
        self._phase, self._since_s = "", 0.0

    def track(self, t_s: float, truth: Truth) -> None:
        """Update the phase with the truth at `t_s`."""
        phase = phase_of(truth)
        if phase != self._phase:
            self._phase, self._since_s = phase, t_s
        if t_s >= FIRST_PHASE_S and t_s - self._since_s >= MIN_PHASE_S and phase != "ground":
            self.begin_s.setdefault(phase, round(t_s, 3))


def phase_of(truth: Truth) -> str:
    """Return the phase of flight at one instant."""
    number = flight_phases(np.array([truth.q_nb]), np.array([truth.v_ned_mps]))[0]
    phase = PHASES[int(number)]
    airborne = truth.height_agl_m > AIRBORNE_M
    if phase == "ground" and airborne:
        return "hover"  # slow, but airborne
    if phase == "descent" and truth.height_agl_m < LANDING_M:
        return "landing"
    return phase
