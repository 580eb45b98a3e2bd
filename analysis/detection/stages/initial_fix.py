"""The first state: a snapshot solution that passes its own test."""

from dataclasses import dataclass

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.covariance_release import FREE_SPEED_MPS
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import (
    CLOCK,
    DRIFT,
    ERROR_SIZE,
    ISB,
    X_CLOCK,
    X_DRIFT,
    X_ISB,
    X_Q,
    X_SIZE,
    V,
    propagate_freely,
    set_unknown_attitude,
)
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.filter.measurement import EpochObservation, Innovations, predict_innovations
from analysis.detection.isolation.hypotheses import (
    SYSTEMS_CONTRADICT,
    explain_by_satellites,
    explain_by_systems,
    group_by_system,
)
from analysis.detection.isolation.trust import TRUSTED_DOF
from analysis.detection.protection_levels import PositionBounds, bound_position
from analysis.detection.receiver.carry_off_windows import LEAST_RATIO_LEAD
from analysis.detection.statistics.bank import projected_weights
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.orbits.broadcast import design_matrix, systems_of
from analysis.samples.sample import Vector

MOST_ITERATIONS = 12  # more means that Gauss-Newton diverges
CONVERGED_M = 1e-3  # a thousandth of a range's noise
NEAR_EARTH_M = 1.0e6  # below this radius elevations and weights are meaningless
ISB_SIGMA_M = 300.0  # one microsecond: a system's first ranges alone determine its offset
UNKNOWN_DRIFT_SIGMA_MPS = 300.0  # 1 ppm: an ordinary crystal


@dataclass(frozen=True, slots=True)
class InitialFix:
    """A first state with its test and the satellites that it isolated; or why there is none."""

    motion: MotionEstimate | None
    reason: str = ""
    faulty: tuple[str, ...] = ()
    statistic: float = 0.0
    dof: int = 0
    threshold: float = 0.0
    bounds: PositionBounds | None = None


def solve_initial_fix(
    t_us: int, observation: EpochObservation, config: DetectorConfig, ionosphere: Vector
) -> InitialFix:
    """Least squares over all satellites above the mask, tested, and repeated without those that
    make it fail.

    `ionosphere` (8,) are Klobuchar's coefficients.
    """
    # First all satellites, since the mask needs a position to compute elevations.
    x = solve_snapshot(observation, np.zeros(X_SIZE), config, ionosphere)
    if x is not None:
        above = predict_innovations(observation, x, config.sigma, ionosphere).elevation_rad
        observation = observation.select(above >= config.mask_rad)
        x = solve_snapshot(observation, x, config, ionosphere)
    if x is None:
        return InitialFix(None, _too_few(observation))
    innovations = predict_innovations(observation, x, config.sigma, ionosphere)
    design = _design(observation, innovations)
    count, unknowns = design.shape
    # Without redundancy a faulty start is not distinguishable from a healthy one.
    if count <= unknowns:
        return InitialFix(None, f"{count} satellites; {unknowns + 1} are needed to test")
    m, dof = projected_weights(design, 1.0 / innovations.variance), count - unknowns
    q = float(innovations.range_m @ (m @ innovations.range_m))
    threshold = chi_square_threshold(dof, config.p_false_alarm)
    faulty: tuple[str, ...] = ()
    if q > threshold:
        subset, reason = _faulty_satellites(innovations, m, q, unknowns, config)
        if reason:
            return InitialFix(None, reason)
        faulty = tuple(observation.satellites[i] for i in subset)
        observation = observation.select(~np.isin(np.arange(count), subset))
        x = solve_snapshot(observation, x, config, ionosphere)
        if x is None:
            return InitialFix(None, _too_few(observation))
        innovations = predict_innovations(observation, x, config.sigma, ionosphere)
        design = _design(observation, innovations)
    motion = _motion(t_us, x, observation, innovations, design, config)
    offset_m, share = np.zeros(len(innovations.range_m)), config.sigma.slow**2
    bounds = bound_position(innovations, np.zeros(3), offset_m, x[:3], VarianceFactor(), share)
    return InitialFix(motion, "", faulty, q, dof, threshold, bounds)


def check_against_prior(
    start: InitialFix, before: MotionEstimate, config: DetectorConfig
) -> InitialFix:
    """The start; or none where it has little redundancy and contradicts the filter before a gap.

    The uncertainty of that filter grows with the gap, so an old position contradicts nothing.
    """
    motion = start.motion
    if motion is None or start.dof >= TRUSTED_DOF:
        return start
    gap_s = (motion.t_us - before.t_us) * 1e-6
    x, p, _ = propagate_freely(before.x, before.p, gap_s, config.noise)
    shift_m = motion.x[:3] - x[:3]
    q = float(shift_m @ np.linalg.solve(p[:3, :3] + motion.p[:3, :3], shift_m))
    if q <= chi_square_threshold(3, config.p_false_alarm):
        return start
    return InitialFix(
        None,
        f"a start {np.linalg.norm(shift_m):.0f} m from where the filter was {gap_s:.0f} s ago, with"
        f" {start.dof} degrees of freedom; {TRUSTED_DOF} are needed to accept it",
    )


def _faulty_satellites(
    innovations: Innovations, m: Vector, q: float, unknowns: int, config: DetectorConfig
) -> tuple[tuple[int, ...], str]:
    """The satellites that make a start of statistic q fail; or none, and why."""
    u = m @ innovations.range_m
    # Two satellites of redundancy for each one left out make the set unique.
    largest = min(config.left_out, (len(u) - unknowns) // 2)
    found = explain_by_satellites(m, u, q, config.p_false_alarm, largest, unknowns)
    if found is None:
        return (), "the first solutions fail their test"
    if len(found.subset) > 1:
        # Which of two systems moved is ambiguous in a snapshot: it must not start in between.
        systems = group_by_system(innovations.geometry)
        wholes = explain_by_systems(m, u, q, systems, config.p_false_alarm)
        if any(whole.cost - found.cost < LEAST_RATIO_LEAD for whole in wholes):
            return (), SYSTEMS_CONTRADICT
        # Three wrong of eight look like two others: the rest must test each other.
        if len(u) - len(found.subset) - unknowns < TRUSTED_DOF:
            few = "satellites contradict the others, which are too few"
            return (), f"{len(found.subset)} of {len(u)} {few}"
    return found.subset, ""


def _design(observation: EpochObservation, innovations: Innovations) -> Vector:
    """The geometry (n, 3 + systems) of a snapshot."""
    return design_matrix(-innovations.geometry[:, 0:3], observation.measurements.system)


def _too_few(observation: EpochObservation) -> str:
    return f"{len(observation.satellites)} satellites with an ephemeris give no position"


def solve_snapshot(
    observation: EpochObservation, x: Vector, config: DetectorConfig, ionosphere: Vector
) -> Vector | None:
    """Position, clock and system offsets by Gauss-Newton from x; None where it fails."""
    x = x.copy()
    # The first system's offset is the clock's; systems out of view have none.
    offset = [X_ISB + kind - 1 for kind in systems_of(observation.measurements.system)[1:]]
    x[[i for i in range(X_ISB, X_SIZE) if i not in offset]] = 0.0
    if len(observation.satellites) < 4 + len(offset):
        return None
    for _ in range(MOST_ITERATIONS):
        # Near the centre of the Earth elevations, and so weights, are meaningless.
        near = float(x[:3] @ x[:3]) > NEAR_EARTH_M**2
        # At the exact centre the lines of sight have no direction.
        innovations = predict_innovations(
            observation, x if near else x + 1e-3, config.sigma, ionosphere
        )
        weight = innovations.variance**-0.5 if near else np.ones(len(innovations.range_m))
        design = _design(observation, innovations) * weight[:, None]
        step, _, rank, _ = np.linalg.lstsq(design, innovations.range_m * weight, rcond=1e-10)
        if rank < design.shape[1] or not np.isfinite(step).all():
            return None
        x[0:3] += step[:3]
        x[[X_CLOCK, *offset]] += step[3:]
        if near and float(np.abs(step[:3]).max()) < CONVERGED_M:
            return x
    return None


def _motion(
    t_us: int,
    x: Vector,
    observation: EpochObservation,
    innovations: Innovations,
    design: Vector,
    config: DetectorConfig,
) -> MotionEstimate:
    """The filter at the solution x, with velocity from Doppler where there is enough of it."""
    p = np.zeros((ERROR_SIZE, ERROR_SIZE))
    weighted = design / np.sqrt(innovations.variance)[:, None]
    # The cofactor of the solution is the covariance, since the rows are weighted by their sigmas.
    cofactor = np.linalg.inv(weighted.T @ weighted)
    p[range(ISB, ERROR_SIZE), range(ISB, ERROR_SIZE)] = ISB_SIGMA_M**2
    others = systems_of(observation.measurements.system)[1:]
    spots = [0, 1, 2, CLOCK, *(ISB + kind - 1 for kind in others)]
    p[np.ix_(spots, spots)] = cofactor
    x = x.copy()
    # No attitude yet: any unit quaternion, with 3 rad of sigma below.
    x[X_Q] = 1.0
    known = np.isfinite(observation.measurements.doppler_mps)
    # Four unknowns and one to spare.
    if known.sum() >= 5:
        h = np.hstack([innovations.geometry[known, 0:3], np.ones((known.sum(), 1))])
        solution, *_ = np.linalg.lstsq(h, innovations.rate_mps[known], rcond=None)
        *velocity_mps, drift_mps = solution
        x[V : V + 3] += velocity_mps
        x[X_DRIFT] += drift_mps
        # Four times the modelled sigma: the start's rates are not tested.
        rate = np.linalg.inv(h.T @ h) * (4.0 * config.sigma.rate_mps) ** 2
        # A floor of 0.1 m/s, also where the geometry is very good.
        p[np.ix_([3, 4, 5, DRIFT], [3, 4, 5, DRIFT])] = rate + 0.01 * np.eye(4)
    else:
        p[[3, 4, 5], [3, 4, 5]] = FREE_SPEED_MPS**2
        p[DRIFT, DRIFT] = UNKNOWN_DRIFT_SIGMA_MPS**2
    set_unknown_attitude(p)
    return MotionEstimate(t_us, x, p)
