"""The main test F00 on all trusted pseudoranges, the bank when it trips, and the update."""

from dataclasses import dataclass, replace

import numpy as np

from analysis.fdi.bank import normalised, projected_weights
from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import CLOCK, DRIFT, ISB, PSI, correct, project
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square
from analysis.fdi.verdict import judge
from analysis.samples import Vector
from analysis.solve import design_matrix

FREE_POSITION_M = 300.0
FREE_SPEED_MPS = 30.0
FREE_TILT_RAD = 0.3
FREE_CLOCK_M = 1e5
FREE_DRIFT_MPS = 100.0
ROUNDS = 3  # a clock jump and a wrong prediction may come together


@dataclass(frozen=True, slots=True)
class Tested:
    """The outcome: the filter updated with what is trusted, and what the tests said.

    `left_out` are indices of satellites found faulty; `normalised` (n,) and the statistics are
    those of the first round, before anything was freed.
    """

    motion: Motion
    hypothesis: str
    alarm: bool
    left_out: tuple[int, ...]
    statistic: float
    dof: int
    threshold: float
    normalised: Vector
    probabilities: dict[str, float]
    parity: tuple[float, float, int]


def parity(modelled: Modelled, galileo: Vector, p_false_alarm: float) -> tuple[float, float, int]:
    """The test that asks the satellites only: statistic, threshold, degrees of freedom."""
    design = design_matrix(modelled.los, galileo)
    dof = len(design) - design.shape[1]
    if dof < 1:
        return 0.0, 0.0, 0
    m = projected_weights(design, modelled.sigma_m**-2.0)
    return float(modelled.v_m @ m @ modelled.v_m), chi_square(dof, p_false_alarm), dof


def largest_set(count: int, wanted: int) -> int:
    """How many satellites may be left out: enough must stay for the set to be the only one."""
    return max(min(wanted, (count - 4) // 2), 1 if count >= 4 else 0)


def check_ranges(
    motion: Motion, modelled: Modelled, galileo: Vector, config: DetectorConfig
) -> Tested:
    """F00, verdict and update with the ranges of `modelled` (n satellites)."""
    count = len(modelled.v_m)
    threshold = chi_square(count, config.p_false_alarm)
    snapshot = parity(modelled, galileo, config.p_false_alarm)
    hypothesis, alarm = "none", False
    chances: dict[str, float] = {}
    statistic, each = -1.0, np.empty(0)
    for _ in range(ROUNDS):
        ph, s = project(motion.p, modelled.h, modelled.sigma_m**2)
        m = np.linalg.inv(s)
        u = m @ modelled.v_m
        q = float(modelled.v_m @ u)
        if statistic < 0.0:
            statistic, each = q, normalised(m, u)
        if q <= threshold:
            motion = _updated(motion, ph, m, modelled.v_m)
            return Tested(
                motion,
                hypothesis,
                alarm,
                (),
                statistic,
                count,
                threshold,
                each,
                chances,
                snapshot,
            )
        verdict = judge(
            m,
            modelled.v_m,
            np.ascontiguousarray(modelled.h[:, 0:3]),
            np.ascontiguousarray(modelled.h[:, CLOCK : CLOCK + 1]),
            config.p_false_alarm,
            largest_set(count, config.left_out),
            config.rule,
        )
        chances = chances or verdict.probabilities
        if verdict.hypothesis == "clock":
            motion = free_clock(motion)
            hypothesis = "clock" if hypothesis == "none" else hypothesis
        elif verdict.hypothesis == "imu":
            if motion.inertial:
                hypothesis, alarm = "imu", True
            motion = free_position(motion)
        else:
            break
    keep = np.ones(count, dtype=bool)
    keep[list(verdict.subset)] = False
    if verdict.hypothesis == "satellites":
        ph, s = project(motion.p, modelled.h[keep], modelled.sigma_m[keep] ** 2)
        motion = _updated(motion, ph, np.linalg.inv(s), modelled.v_m[keep])
    hypothesis = hypothesis if hypothesis == "imu" else verdict.hypothesis
    return Tested(
        motion,
        hypothesis,
        True,
        verdict.subset,
        statistic,
        count,
        threshold,
        each,
        chances,
        snapshot,
    )


def _updated(motion: Motion, ph: Vector, m: Vector, v: Vector) -> Motion:
    x, p = correct(motion.x, motion.p, ph @ m, ph, v)
    return replace(motion, x=x, p=p)


def free_clock(motion: Motion) -> Motion:
    """The filter with its clock forgotten: jumps of the receiver's clock are states."""
    p = motion.p.copy()
    p[CLOCK, CLOCK] += FREE_CLOCK_M**2
    p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
    return replace(motion, p=p)


def free_position(motion: Motion) -> Motion:
    """The filter with its position and velocity forgotten, moved freely from here."""
    p = motion.p.copy()
    for at, sigma in ((0, FREE_POSITION_M), (3, FREE_SPEED_MPS), (PSI, FREE_TILT_RAD)):
        p[range(at, at + 3), range(at, at + 3)] += sigma**2
    return replace(motion, p=p, inertial=False, alignment=None)


def widen_offset(motion: Motion, sigma_m: float) -> Motion:
    """The filter with Galileo's offset unknown: its first satellites have come."""
    p = motion.p.copy()
    p[ISB, ISB] += sigma_m**2
    return replace(motion, p=p)
