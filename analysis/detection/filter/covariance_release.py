"""States of the filter that a fault has made unknown: their covariance is made wide again."""

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, DRIFT, ERROR_SIZE, ISB, PSI

# One sigma of what a prediction that was found wrong is trusted to from then on: 10 s of motion at
# the speed of a fast small vehicle, a tilt just below LOST_TILT_RAD, and 0.3 ppm of a TCXO's 0.5.
FREE_POSITION_M, FREE_SPEED_MPS, FREE_TILT_RAD, FREE_DRIFT_MPS = 300.0, 30.0, 0.3, 100.0
CLOCK_JUMP_M = 1000.0  # a larger jump on most satellites is a receiver that set its clock: removed


def free_clock(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its clock forgotten: jumps of the receiver's clock are states."""
    p = motion.p.copy()
    p[CLOCK, CLOCK] += CLOCK_JUMP_M**2
    p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
    return motion._replace(p=p)


def free_system_clocks(motion: MotionEstimate) -> MotionEstimate:
    """The filter with the systems' offsets forgotten; which clock left is not asked."""
    motion = free_clock(motion)
    p = motion.p.copy()
    p[range(ISB, ERROR_SIZE), range(ISB, ERROR_SIZE)] += CLOCK_JUMP_M**2
    return motion._replace(p=p)


def free_position(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its position and velocity forgotten, moved freely from here."""
    p = motion.p.copy()
    # Added, not set: what is unsure already does not become surer.
    for at, sigma in ((0, FREE_POSITION_M), (3, FREE_SPEED_MPS), (PSI, FREE_TILT_RAD)):
        p[range(at, at + 3), range(at, at + 3)] += sigma**2
    return motion._replace(p=p, inertial=False, alignment=None)


def free_by_rates(motion: MotionEstimate, hypothesis: str) -> MotionEstimate:
    """The filter before the range update, with the states that the rates contradict released."""
    if hypothesis == "imu":
        return free_position(motion)
    if hypothesis == "clock":
        p = motion.p.copy()
        p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
        return motion._replace(p=p)
    return motion
