"""A receiver's clock that runs away: a spoofer that drags the time and leaves the position.

A crystal's frequency follows its temperature. The clocks of four recorded receivers change their
drift by 2 m/s at most within a second (15 m/s in an urban canyon, with 30 m of errors on ranges);
what changes it by more than 20 m/s is no crystal.
"""

import math
from collections.abc import Sequence

from analysis.detection.detector_state import EpochRecord
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, X_DRIFT
from analysis.results import Result, pattern_alarm

MOST_MPS = 20.0  # 67 nanoseconds each second
OVER_US, LONGEST_US = 900_000, 2_000_000
SIGMAS = 5.0


def clock_results(motion: MotionEstimate, history: Sequence[EpochRecord]) -> list[Result]:
    """An alarm where the clock's drift changes faster than any crystal's."""
    t_us = motion.t_us
    # From the newest on: what is asked for is a few epochs back, however long the history.
    back = next((one for one in reversed(history) if t_us - one.t_us >= OVER_US), None)
    if back is None or back.core.motion is None or t_us - back.t_us > LONGEST_US:
        return []
    before = back.core.motion
    over_s = (t_us - before.t_us) * 1e-6
    change_mps = motion.x[X_DRIFT] - before.x[X_DRIFT]
    sigma_mps = math.sqrt(motion.p[DRIFT, DRIFT] + before.p[DRIFT, DRIFT])
    if abs(change_mps) <= MOST_MPS * max(over_s, 1.0) + SIGMAS * sigma_mps:
        return []
    return [
        pattern_alarm(
            t_us,
            "satellites",
            f"the receiver's clock drifts otherwise by {change_mps:.0f} m/s at once",
            suspect="clock",
        )
    ]
