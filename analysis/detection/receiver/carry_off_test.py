"""Tests for the carry-off of a receiver (slow spoofing) and for its end."""

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.propagation import ImuSegment
from analysis.detection.receiver.carry_off_windows import (
    CarryOff,
    CarryOffDetection,
    extend_windows,
    fits_carry_off,
    fix_innovation,
    new_windows,
    renew_oldest_window,
    search_windows,
)
from analysis.detection.receiver.position_test import (
    VELOCITY_SIGMA_MPS,
    AssessedFix,
    known_or_zero,
)
from analysis.detection.receiver.receiver_or_imu import mean_force
from analysis.detection.receiver.receiver_state import LastFix, ReceiverState
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.sample import Vector

# From fix to fix: half of gravity, as by a tilt of 0.5 rad. A harder impact that the IMU overstates
# would be a carry-off.
IMPACT_MPS2 = 5.0


def detect_carry_off(
    receiver: ReceiverState, assessed: AssessedFix, is_trusted: bool, config: FilterConfig
) -> tuple[ReceiverState, CarryOffDetection | None, Vector | None]:
    """The windows' verdict after a fix: a receiver that is carried off, or a wrong acceleration
    (3,). The windows restart after any other detection; `is_trusted` says that nothing is excluded.
    """
    prediction, motion = assessed.prediction, assessed.motion
    v_ned_mps = assessed.measurement.v_ned_mps
    moved = prediction.is_inertial and is_trusted
    if v_ned_mps is None or assessed.velocity is None or not (moved and assessed.passes):
        return receiver._replace(windows=None), None, None
    windows = receiver.windows if receiver.windows is not None else new_windows(motion.t_us)
    axes, innovation = assessed.measurement.axes, fix_innovation(assessed)
    windows = extend_windows(
        windows, motion.t_us, prediction.dt_s, prediction.transition, axes, innovation
    )
    if receiver.scatter.shaken_us == motion.t_us or _shows_impact(
        receiver.last_fix, prediction.segment
    ):
        windows = windows._replace(doubt_us=motion.t_us, impact_us=motion.t_us)
    found = wrong_mps2 = None
    # Touching down stops a receiver, by a force that an IMU is often too slow to show.
    if float(np.linalg.norm(known_or_zero(v_ned_mps))) > VELOCITY_SIGMA_MPS[0]:
        # One share for all windows: they overlap nearly whole, and what they say changes slowly.
        windows, found, wrong_mps2 = search_windows(
            windows, motion.t_us, chi_square_threshold(3, config.p_slow)
        )
    if found is not None:
        return receiver._replace(windows=None), found, None
    # A real receiver smooths its velocity and comes late, so that a sound IMU contradicts it.
    if receiver.latency.variance > 0.0:
        wrong_mps2 = None
    windows = renew_oldest_window(windows, motion.t_us)
    return receiver._replace(windows=windows), None, wrong_mps2


def _shows_impact(last: LastFix | None, segment: ImuSegment) -> bool:
    """Whether the specific force changed by so much since the last fix that its integral is not
    to be relied upon: a collision or a hard landing."""
    force = mean_force(segment)
    if last is None or force is None or not last.forces_b_mps2:
        return False
    return float(np.linalg.norm(force - last.forces_b_mps2[0])) > IMPACT_MPS2


def estimate_carry_off(last: LastFix | None, fix: AssessedFix) -> CarryOff | None:
    """How a receiver that is left out now is carried off, where its velocity shows it."""
    v_ned_mps, velocity = fix.measurement.v_ned_mps, fix.velocity
    if v_ned_mps is None or velocity is None or velocity.passes or last is None:
        return None
    u_ned_mps = np.zeros(3)
    u_ned_mps[np.isfinite(v_ned_mps)] = velocity.v
    return CarryOff(last.t_us, u_ned_mps)


def is_still_carried_off(carry_off: CarryOff | None, fix: AssessedFix) -> bool:
    """Whether an excluded receiver continues its carry-off: without it the filter is too
    uncertain."""
    if carry_off is None or fix.velocity is None:
        return False
    return fits_carry_off(carry_off, fix.motion.t_us, fix_innovation(fix))
