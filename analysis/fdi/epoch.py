"""One GNSS epoch against the filter: everything the detector decides there."""

from dataclasses import dataclass, replace

import numpy as np

from analysis.fdi.align import find_attitude
from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core
from analysis.fdi.exclusion import exclude, readmit
from analysis.fdi.inertial import X_CLOCK
from analysis.fdi.measure import Modelled, Observed, model
from analysis.fdi.motion import Segment, advance
from analysis.fdi.ranges import Tested, check_ranges, free_clock, free_position, parity
from analysis.fdi.rates import RatesTested, check_rates, freed_by, use_rates
from analysis.fdi.slow import SlowVerdict, judge_slow, new_memory, remember
from analysis.fdi.state import Motion
from analysis.samples import Vector

CLOCK_LEAP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites


@dataclass(frozen=True, slots=True)
class Outcome:
    """What an epoch said; None for `tested` where it could not be tested (`reason` says why)."""

    core: Core
    reason: str = ""
    names: tuple[str, ...] = ()
    used: Modelled | None = None
    tested: Tested | None = None
    rates: RatesTested | None = None
    slow: SlowVerdict | None = None
    parity: tuple[float, float, int] = (0.0, 0.0, 0)
    hypothesis: str = "untestable"
    alarm: bool = False
    imu_blamed: bool = False
    was_inertial: bool = False


def judge_epoch(
    t_us: int, observed: Observed, part: Segment, core: Core, config: DetectorConfig
) -> Outcome:
    """Predict, test, isolate, update: the core after an epoch and what it said."""
    before = core.motion
    assert before is not None
    motion, phi = advance(before, part, t_us, config)
    observed, modelled, motion, leapt = _modelled(observed, motion, core.ionosphere, config)
    trusted, used, galileo, names = observed, modelled, observed.galileo, observed.satellites
    if core.excluded:
        keep = np.array([name not in core.excluded for name in names], dtype=bool)
        trusted, used, galileo = observed.select(keep), modelled.select(keep), galileo[keep]
        names = trusted.satellites
    needed = 3 if motion.inertial else 5 + int(0 < galileo.sum() < len(galileo))
    if len(names) < needed:
        reason = f"{len(names)} healthy satellites above the mask; {needed} are needed"
        return Outcome(replace(core, motion=motion, memory=None), reason)
    rates = check_rates(motion, used, config)
    tested = check_ranges(freed_by(motion, rates.hypothesis), used, config)
    excluded = readmit(core.excluded, observed.satellites, modelled, motion.p, t_us, config)
    excluded = exclude(excluded, tuple(names[i] for i in tested.left_out), t_us, t_us)
    moved, update = tested.motion, None
    if rates.fit.any():
        after = model(trusted, moved.x, config.sigma, core.ionosphere)
        moved, update = use_rates(moved, after, rates.fit)
    memory = None
    undisturbed = not leapt and not tested.freed and rates.hypothesis in ("none", "satellites")
    if undisturbed and tested.update is not None and before.inertial == moved.inertial:
        memory = remember(
            core.memory or new_memory(before.t_us),
            t_us,
            (t_us - before.t_us) * 1e-6,
            phi,
            names,
            used.variance,
            tested.update,
            update,
        )
    slow = judge_slow(memory, t_us, moved.inertial, config) if memory is not None else None
    blamed = before.inertial and (
        "imu" in (rates.hypothesis, tested.hypothesis)
        or (slow is not None and slow.hypothesis == "imu")
    )
    if blamed and moved.inertial:
        moved = free_position(moved)
    core = _imu_verdict(replace(core, excluded=excluded, ranges_us=t_us), blamed, t_us, config)
    moved = find_attitude(core, moved, part, (t_us - before.t_us) * 1e-6, config)
    core = _unknown(replace(core, motion=moved, memory=memory), tested.hypothesis, t_us, config)
    silent = before.inertial and part.gap_s > config.gap_s
    return Outcome(
        core,
        names=names,
        used=used,
        tested=tested,
        rates=rates,
        slow=slow,
        parity=parity(used, galileo, config.p_false_alarm),
        hypothesis=_shown(core, tested.hypothesis, blamed or silent, leapt),
        alarm=tested.alarm or blamed or silent,
        imu_blamed=blamed,
        was_inertial=before.inertial,
    )


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


def _modelled(
    observed: Observed, motion: Motion, ionosphere: Vector, config: DetectorConfig
) -> tuple[Observed, Modelled, Motion, bool]:
    """Satellites above the mask with their innovations; and whether the clock was set."""
    modelled = model(observed, motion.x, config.sigma, ionosphere)
    above = modelled.elevation_rad >= np.radians(config.mask_deg)
    if not above.all():
        observed, modelled = observed.select(above), modelled.select(above)
    count = len(modelled.v_m)
    leap = float(np.sort(modelled.v_m)[count // 2]) if count else 0.0
    if abs(leap) <= CLOCK_LEAP_M:
        return observed, modelled, motion, False
    x = motion.x.copy()
    x[X_CLOCK] += leap
    motion = free_clock(replace(motion, x=x))
    return observed, model(observed, x, config.sigma, ionosphere), motion, True


def _imu_verdict(core: Core, blamed: bool, t_us: int, config: DetectorConfig) -> Core:
    """The IMU held out for a while once it was blamed."""
    if blamed:
        return replace(core, imu_bad_until_us=t_us + round(config.imu_hold_s * 1e6))
    if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
        return replace(core, imu_bad_until_us=None)
    return core


def _unknown(core: Core, hypothesis: str, t_us: int, config: DetectorConfig) -> Core:
    """A filter that nothing fits for too long is started anew."""
    if hypothesis != "multiple-unknown":
        return replace(core, unknown_since_us=None) if core.unknown_since_us else core
    since = core.unknown_since_us or t_us
    if (t_us - since) * 1e-6 >= config.reset_s:
        return replace(core, motion=None, memory=None, unknown_since_us=None)
    return replace(core, unknown_since_us=since)
