"""Detects a receiver clock whose drift changes too fast: spoofing of time alone.

A crystal's frequency follows its temperature. The clocks of four recorded receivers change their
drift by at most 2 m/s within a second (15 m/s in an urban canyon, with range errors of 30 m); a
change of more than 20 m/s is not a crystal's.
"""

import math
from collections.abc import Sequence

from analysis.detection.detector_state import EpochRecord
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, X_DRIFT
from analysis.results import Result, pattern_alarm

MOST_MPS = 20.0  # 67 ns/s; see the recordings above
OVER_US, LONGEST_US = 900_000, 2_000_000  # one second, of epochs at 1 Hz or faster; two of them
SIGMAS = 5.0  # of the change, p 6e-7: a start without Doppler learns its drift within seconds


def clock_results(motion: MotionEstimate, history: Sequence[EpochRecord]) -> list[Result]:
    """An alarm if the clock's drift changes faster than any crystal's."""
    t_us = motion.t_us
    # From the newest on: the record is a few epochs back, however long the history.
    earlier = next((record for record in reversed(history) if t_us - record.t_us >= OVER_US), None)
    if earlier is None or earlier.core.motion is None or t_us - earlier.t_us > LONGEST_US:
        return []
    before = earlier.core.motion
    over_s = (t_us - before.t_us) * 1e-6
    change_mps = motion.x[X_DRIFT] - before.x[X_DRIFT]
    sigma_mps = math.sqrt(motion.p[DRIFT, DRIFT] + before.p[DRIFT, DRIFT])
    if abs(change_mps) <= MOST_MPS * max(over_s, 1.0) + SIGMAS * sigma_mps:
        return []
    return [
        pattern_alarm(
            t_us,
            "satellites",
            f"the drift of the receiver's clock changed by {change_mps:.0f} m/s at once",
            suspect="clock",
        )
    ]
