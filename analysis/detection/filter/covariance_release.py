"""States of the filter that a fault has made unknown: their covariance is made wide again."""

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, DRIFT, ERROR_SIZE, ISB, PSI, R, V

# One sigma of what a prediction that was found wrong is trusted to from then on: 10 s of motion at
# the speed of a fast small vehicle, a tilt just below LOST_TILT_RAD, and 0.3 ppm of a TCXO's 0.5.
FREE_POSITION_M, FREE_SPEED_MPS, FREE_TILT_RAD, FREE_DRIFT_MPS = 300.0, 30.0, 0.3, 100.0
CLOCK_JUMP_M = 1000.0  # a larger jump on most satellites is a receiver that set its clock: removed


def release(motion: MotionEstimate, *states: tuple[int, int, float]) -> MotionEstimate:
    """The filter with variances added: the first of some states, how many, and how much."""
    p = motion.p.copy()
    # Added, not set: what is unsure already does not become surer.
    for at, count, variance in states:
        p[range(at, at + count), range(at, at + count)] += variance
    return motion._replace(p=p)


def free_drift(motion: MotionEstimate) -> MotionEstimate:
    """The filter with the drift of its clock forgotten."""
    return release(motion, (DRIFT, 1, FREE_DRIFT_MPS**2))


def free_clock(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its clock forgotten: jumps of the receiver's clock are states."""
    return release(free_drift(motion), (CLOCK, 1, CLOCK_JUMP_M**2))


def free_system_clocks(motion: MotionEstimate) -> MotionEstimate:
    """The filter with the systems' offsets forgotten; which clock left is not asked."""
    return release(free_clock(motion), (ISB, ERROR_SIZE - ISB, CLOCK_JUMP_M**2))


def free_position(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its position and velocity forgotten, moved freely from here."""
    sigmas = (R, FREE_POSITION_M), (V, FREE_SPEED_MPS), (PSI, FREE_TILT_RAD)
    motion = release(motion, *((at, 3, sigma**2) for at, sigma in sigmas))
    return motion._replace(inertial=False, alignment=None)


def free_by_rates(motion: MotionEstimate, hypothesis: str) -> MotionEstimate:
    """The filter before the range update, with the states that the rates contradict released."""
    if hypothesis == "imu":
        return free_position(motion)
    return free_drift(motion) if hypothesis == "clock" else motion
