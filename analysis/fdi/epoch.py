"""One GNSS epoch against the filter: everything the detector decides there."""

import math
from typing import NamedTuple

import numpy as np

from analysis.fdi.align import find_attitude
from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core
from analysis.fdi.exclusion import NOBODY, Outside, exclude, outside, readmit
from analysis.fdi.inertial import X_CLOCK
from analysis.fdi.measure import Modelled, Observed, model
from analysis.fdi.motion import Segment, advance
from analysis.fdi.offsets import held, hold, learnt
from analysis.fdi.ranges import Tested, check_ranges, free_clock, free_position
from analysis.fdi.rates import RatesTested, check_rates, freed_by
from analysis.fdi.slow import SlowVerdict, judge_slow, new_memory, remember
from analysis.fdi.state import Motion
from analysis.fdi.update import Assessed, absorb, assess, innovated
from analysis.samples import Vector

CLOCK_LEAP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites


class Outcome(NamedTuple):
    """What an epoch said; None for `tested` where it could not be tested (`reason` says why)."""

    core: Core
    reason: str = ""
    names: tuple[str, ...] = ()
    used: Modelled | None = None
    left: Outside = NOBODY
    assessed: Assessed | None = None
    tested: Tested | None = None
    rates: RatesTested | None = None
    slow: SlowVerdict | None = None
    hypothesis: str = "untestable"
    alarm: bool = False
    imu_blamed: bool = False
    was_inertial: bool = False


class Seen(NamedTuple):
    """An epoch before the filter, and whether the clock was set.

    `used` are the innovations of `names` (n satellites), which are trusted, `galileo` (n,) a mask
    of them; `left` those of `others`, which are left out.
    """

    names: tuple[str, ...]
    galileo: Vector
    used: Modelled
    leapt: bool
    others: tuple[str, ...] = ()
    left: Modelled | None = None


def judge_epoch(
    t_us: int, observed: Observed, part: Segment, core: Core, config: DetectorConfig
) -> Outcome:
    """Predict, test, isolate, update: the core after an epoch and what it said."""
    before = core.motion
    assert before is not None
    motion, phi = advance(before, part, t_us, config)
    seen, motion, core = _seen(t_us, observed, motion, core, config)
    names, used = seen.names, seen.used
    needed = 3 if motion.inertial else 5
    if len(names) == needed == 5:
        needed += int(0 < seen.galileo.sum() < 5)
    if len(names) < needed:
        reason = f"{len(names)} healthy satellites above the mask; {needed} are needed"
        core = hold(core, t_us, config)
        return Outcome(core._replace(motion=motion, memory=None), reason)
    assessed = assess(motion.p, used, seen.galileo)
    rates = check_rates(motion, used, assessed, config)
    tested = _tested(t_us, core, motion, seen, assessed, rates.hypothesis, config)
    moved, update = absorb(tested.motion, tested.part, tested.taken, rates.fit)
    memory, slow = None, None
    undisturbed = not seen.leapt and not tested.freed and rates.hypothesis in ("none", "satellites")
    if undisturbed and before.inertial == moved.inertial:
        memory, dt_s = core.memory or new_memory(before.t_us), (t_us - before.t_us) * 1e-6
        memory = remember(memory, t_us, dt_s, phi, names, motion.p, update, config)
        slow = judge_slow(memory, t_us, moved.inertial, config)
    wrong = slow.hypothesis if slow is not None else "none"
    blamed = before.inertial and "imu" in (rates.hypothesis, tested.hypothesis, wrong)
    if blamed and moved.inertial:
        moved = free_position(moved)
    left = outside(seen.others, seen.left, motion, moved) if seen.left is not None else NOBODY
    excluded = readmit(core.excluded, left, t_us, config)
    excluded = exclude(excluded, tuple(names[i] for i in tested.left_out), t_us, t_us)
    if memory is None:
        core = hold(core, t_us, config)
    core = core._replace(ranges_us=t_us, memory=memory, excluded=excluded)
    core = _imu_verdict(core, blamed, t_us, config)
    moved = find_attitude(core, moved, part, (t_us - before.t_us) * 1e-6, config)
    core = _unknown(core._replace(motion=moved), tested.hypothesis, t_us, config)
    silent = before.inertial and part.gap_s > config.gap_s
    return Outcome(
        core,
        names=names,
        used=used,
        left=left,
        assessed=assessed,
        tested=tested,
        rates=rates,
        slow=slow,
        hypothesis=_shown(core, tested.hypothesis, blamed or silent, seen.leapt),
        alarm=tested.alarm or blamed or silent,
        imu_blamed=blamed,
        was_inertial=before.inertial,
    )


def _tested(
    t_us: int,
    core: Core,
    motion: Motion,
    seen: Seen,
    assessed: Assessed,
    by_rates: str,
    config: DetectorConfig,
) -> Tested:
    """The ranges' test after what the rates have said of the prediction."""
    freed = freed_by(motion, by_rates)
    first = assessed.ranges if freed is motion else innovated(freed.p, seen.used)
    return check_ranges(freed, seen.used, first, learnt(core, seen.names), config)


def _shown(core: Core, hypothesis: str, imu: bool, leapt: bool) -> str:
    """The hypothesis of the epoch; an isolation holds until it is taken back."""
    if imu:
        return "imu"
    if hypothesis != "none":
        return hypothesis
    if leapt:
        return "clock"
    if core.imu_bad_until_us is not None:
        return "imu"
    return "satellites" if core.excluded else "none"


def _seen(
    t_us: int, observed: Observed, motion: Motion, core: Core, config: DetectorConfig
) -> tuple[Seen, Motion, Core]:
    """Satellites above the mask with their innovations; the clock set where it leapt.

    Where others are trusted than at the last epoch, what was learnt of them is held.
    """
    modelled = model(observed, motion.x, config.sigma, core.ionosphere)
    above = modelled.elevation_rad >= math.radians(config.mask_deg)
    if not above.all():
        observed, modelled = observed.select(above), modelled.select(above)
    names, galileo = observed.satellites, observed.galileo
    leap = sorted(modelled.v_m.tolist())[len(names) // 2] if names else 0.0
    leapt = abs(leap) > CLOCK_LEAP_M
    if leapt:
        x = motion.x.copy()
        x[X_CLOCK] += leap
        motion = free_clock(motion._replace(x=x))
        modelled = modelled._replace(v_m=modelled.v_m - leap)
    trusted = tuple(name for name in names if name not in core.excluded)
    if core.memory is not None and core.memory.names != trusted:
        core = hold(core, t_us, config)
    if core.held.offsets_m:
        modelled = modelled._replace(v_m=modelled.v_m - held(core, names, t_us, config))
    if len(trusted) == len(names):
        return Seen(names, galileo, modelled, leapt), motion, core
    keep = np.array([name not in core.excluded for name in names], dtype=bool)
    others = tuple(name for name in names if name in core.excluded)
    used, left = modelled.select(keep), modelled.select(~keep)
    return Seen(trusted, galileo[keep], used, leapt, others, left), motion, core


def _imu_verdict(core: Core, blamed: bool, t_us: int, config: DetectorConfig) -> Core:
    """The IMU held out for a while once it was blamed."""
    if blamed:
        return core._replace(imu_bad_until_us=t_us + round(config.imu_hold_s * 1e6))
    if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
        return core._replace(imu_bad_until_us=None)
    return core


def _unknown(core: Core, hypothesis: str, t_us: int, config: DetectorConfig) -> Core:
    """A filter that nothing fits for too long is started anew."""
    if hypothesis != "multiple-unknown":
        return core._replace(unknown_since_us=None) if core.unknown_since_us else core
    since = core.unknown_since_us or t_us
    if (t_us - since) * 1e-6 >= config.reset_s:
        return core._replace(motion=None, memory=None, unknown_since_us=None)
    return core._replace(unknown_since_us=since)
