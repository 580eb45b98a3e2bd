"""The main test F00 on all trusted pseudoranges, the bank when it trips, and the update."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.fdi.bank import normalised, projected_weights
from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import CLOCK, DRIFT, ISB, PSI, correct, innovate
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square
from analysis.fdi.verdict import Verdict, judge
from analysis.samples import Vector

Indices = NDArray[np.int64]
FREE_POSITION_M = 300.0
FREE_SPEED_MPS = 30.0
FREE_TILT_RAD = 0.3
FREE_CLOCK_M = 1000.0  # larger jumps are taken off before
FREE_DRIFT_MPS = 100.0
ROUNDS = 3  # a clock jump and a wrong prediction may come together


@dataclass(frozen=True, slots=True)
class Update:
    """What an update of the filter used: gain (18, m), inverse covariance (m, m), geometry
    (m, 18), innovations (m,), and which satellites of the test they are of (m,)."""

    gain: Vector
    m: Vector
    h: Vector
    v: Vector
    which: Indices


@dataclass(frozen=True, slots=True)
class Tested:
    """The outcome: the filter updated with what is trusted, and what the tests said.

    `left_out` are indices of satellites found faulty; `normalised` (n,) and the statistic are
    those of the first round, before anything was freed. `update` is None where nothing was used,
    `freed` says whether the clock or the position was forgotten.
    """

    motion: Motion
    hypothesis: str
    alarm: bool
    left_out: tuple[int, ...]
    statistic: float
    threshold: float
    normalised: Vector
    probabilities: dict[str, float]
    update: Update | None
    freed: bool


def parity(modelled: Modelled, galileo: Vector, p_false_alarm: float) -> tuple[float, float, int]:
    """The test that asks the satellites only: statistic, threshold, degrees of freedom."""
    mixed = 0 < int(galileo.sum()) < len(galileo)
    design = modelled.h[:, [0, 1, 2, CLOCK, ISB] if mixed else [0, 1, 2, CLOCK]]
    dof = len(design) - design.shape[1]
    if dof < 1:
        return 0.0, 0.0, 0
    m = projected_weights(np.ascontiguousarray(design), 1.0 / modelled.variance)
    return float(modelled.v_m @ m @ modelled.v_m), chi_square(dof, p_false_alarm), dof


def largest_set(count: int, wanted: int) -> int:
    """How many satellites may be left out: enough must stay for the set to be the only one."""
    return max(min(wanted, (count - 4) // 2), 1 if count >= 4 else 0)


def check_ranges(motion: Motion, modelled: Modelled, config: DetectorConfig) -> Tested:
    """F00, verdict and update with the ranges of `modelled` (n satellites)."""
    count = len(modelled.v_m)
    threshold = chi_square(count, config.p_false_alarm)
    everyone = np.arange(count)
    ph, m, u, q = innovate(motion.p, modelled.h, modelled.variance, modelled.v_m)
    statistic, each = q, normalised(m, u)
    if q <= threshold:
        motion, update = _updated(motion, modelled, everyone, (ph, m, u))
        return Tested(motion, "none", False, (), q, threshold, each, {}, update, False)
    hypothesis, verdict, motion = _freed(motion, modelled, threshold, config)
    used: Update | None = None
    if verdict.hypothesis in ("none", "satellites"):
        keep = np.ones(count, dtype=bool)
        keep[list(verdict.subset)] = False
        part = modelled.select(keep)
        ph, m, u, q = innovate(motion.p, part.h, part.variance, part.v_m)
        motion, used = _updated(motion, part, everyone[keep], (ph, m, u))
    blamed = verdict.hypothesis if hypothesis in ("none", "clock") else hypothesis
    shown = hypothesis if verdict.hypothesis == "none" else blamed
    alarm = shown not in ("none", "clock")
    subset, chances = verdict.subset, verdict.probabilities
    return Tested(motion, shown, alarm, subset, statistic, threshold, each, chances, used, True)


def _freed(
    motion: Motion, modelled: Modelled, threshold: float, config: DetectorConfig
) -> tuple[str, Verdict, Motion]:
    """Judge what failed; forget the clock or the position where they explain it, and judge again.

    The hypothesis so far, the last verdict ("none" once what is left passes), and the filter. A
    prediction without an IMU claims little: its failure is a manoeuvre and no fault.
    """
    hypothesis = "none"
    chances: dict[str, float] = {}
    largest = largest_set(len(modelled.v_m), config.left_out)
    position = np.ascontiguousarray(modelled.h[:, 0:3])
    clock = np.ascontiguousarray(modelled.h[:, CLOCK : CLOCK + 1])
    for _ in range(ROUNDS):
        _, m, _, q = innovate(motion.p, modelled.h, modelled.variance, modelled.v_m)
        if q <= threshold:
            return hypothesis, Verdict("none", (), chances), motion
        verdict = judge(
            m, modelled.v_m, position, clock, config.p_false_alarm, largest, config.rule
        )
        chances = chances or verdict.probabilities
        if verdict.hypothesis == "clock":
            motion = free_clock(motion)
            hypothesis = "clock" if hypothesis == "none" else hypothesis
        elif verdict.hypothesis == "imu":
            hypothesis = "imu" if motion.inertial else hypothesis
            motion = free_position(motion)
        else:
            return hypothesis, replace(verdict, probabilities=chances), motion
    return hypothesis, Verdict("multiple-unknown", (), chances), motion


def _updated(
    motion: Motion, part: Modelled, which: Indices, innovated: tuple[Vector, Vector, Vector]
) -> tuple[Motion, Update]:
    ph, m, u = innovated
    x, p, gain = correct(motion.x, motion.p, part.h, part.variance, ph, m, u)
    return replace(motion, x=x, p=p), Update(gain, m, part.h, part.v_m, which)


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
