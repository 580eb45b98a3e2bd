"""The detector: samples in, a decision for each GNSS epoch out."""

from dataclasses import dataclass, field, replace

import msgspec
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.exclusion import exclude, readmit
from analysis.fdi.inertial import X_CLOCK
from analysis.fdi.measure import Modelled, Observed, model, observe
from analysis.fdi.motion import (
    Segment,
    advance,
    find_attitude,
    keep_pending,
    segment,
    split_pending,
)
from analysis.fdi.position import step_position
from analysis.fdi.ranges import Tested, check_ranges, free_clock
from analysis.fdi.rates import RatesTested, check_rates, freed_by, use_rates
from analysis.fdi.start import start
from analysis.fdi.state import Core, Motion, State
from analysis.fdi.thresholds import p_value
from analysis.gnss import pack_ephemeris
from analysis.results import Decision, Result, SensorDecision
from analysis.samples import (
    EphemerisSample,
    Epoch,
    GpsFix,
    ImuSample,
    IonosphereSample,
    MagSample,
    Sample,
    Vector,
)

EPHEMERIDES_KEPT = 16  # per satellite, the newest
CLOCK_LEAP_M = 1000.0  # the receiver set its clock: no fault has this on most satellites


@dataclass(frozen=True)
class Detector:
    """Finds which satellite, or the IMU, is lying; see docs/fdi.md."""

    config: DetectorConfig = field(default_factory=DetectorConfig)

    def new_state(self) -> State:
        """Nothing known."""
        return State(Core(None, {}, np.array(self.config.ionosphere, dtype=float)))

    def step(self, sample: Sample, state: State) -> tuple[list[Result], State]:
        """Decisions that one sample allows, and the next state."""
        kind = type(sample)
        if kind is ImuSample:
            return self._imu(sample, state)  # type: ignore[arg-type]
        if kind is Epoch:
            return self._epoch(sample, state)  # type: ignore[arg-type]
        if kind is MagSample:
            return [], State(replace(state.core, mag_b=sample.field_b_gauss), state.pending)  # type: ignore[union-attr]
        if isinstance(sample, GpsFix):
            ranges_us = state.core.ranges_us
            if ranges_us is not None and sample.t_us - ranges_us < self.config.reset_s * 1e6:
                return [], state
            return step_position(sample, state, self.config)
        if isinstance(sample, EphemerisSample):
            return [], State(_learn(state.core, sample), state.pending)
        if isinstance(sample, IonosphereSample):
            known = np.array(sample.alpha + sample.beta)
            return [], State(replace(state.core, ionosphere=known), state.pending)
        return [], state

    def _imu(self, sample: ImuSample, state: State) -> tuple[list[Result], State]:
        core, pending = state
        if core.imu_id is None:
            core = replace(core, imu_id=sample.id)
        if core.imu_id != sample.id or (pending is not None and sample.t_us <= pending.sample.t_us):
            return [], State(core, pending)
        return [], State(core, keep_pending(sample, pending))

    def _epoch(self, epoch: Epoch, state: State) -> tuple[list[Result], State]:
        core, pending = state
        observed, reason = observe(epoch, core.ephemerides)
        motion = core.motion
        if observed is None:
            return [_untestable(epoch, reason, core)], state
        if motion is not None:
            since_s = (epoch.t_us - motion.t_us) * 1e-6
            if -self.config.reset_s < since_s <= 0.0:
                return [_untestable(epoch, f"time went back by {-since_s:.3f} s", core)], state
            if not 0.0 < since_s <= self.config.reset_s:
                core = replace(core, motion=None, excluded={})
                motion = None
        run, pending = split_pending(pending, epoch.t_us)
        if motion is None:
            results, core = self._start(epoch, observed, core)
            return results, State(core, pending)
        part = segment(run, motion, epoch.t_us)
        results, core = self._test(epoch, observed, part, core, motion)
        return results, State(core, pending)

    def _start(self, epoch: Epoch, observed: Observed, core: Core) -> tuple[list[Result], Core]:
        begun = start(epoch.t_us, observed, self.config, core.ionosphere)
        if begun.motion is None:
            return [_untestable(epoch, begun.reason, core)], core
        core = replace(
            core,
            motion=begun.motion,
            ranges_us=epoch.t_us,
            excluded=exclude(core.excluded, begun.left_out, epoch.t_us),
            unknown_since_us=None,
        )
        decision = Decision(
            t_s=epoch.t_us * 1e-6,
            t_us=epoch.t_us,
            statistic=begun.statistic,
            threshold=begun.threshold,
            dof=begun.dof,
            p_value=p_value(begun.statistic, begun.dof),
            alarm=bool(begun.left_out),
            hypothesis="satellites" if core.excluded else "none",
            excluded=tuple(sorted(core.excluded)),
            satellites=observed.satellites,
            position_ecef_m=_triple(begun.motion.x[:3]),
            position_sigma_m=_triple(np.sqrt(np.diag(begun.motion.p)[:3])),
            mode="start",
        )
        return [decision], core

    def _test(
        self, epoch: Epoch, observed: Observed, part: Segment, core: Core, motion: Motion
    ) -> tuple[list[Result], Core]:
        config = self.config
        dt_s = (epoch.t_us - motion.t_us) * 1e-6
        was_inertial = motion.inertial
        motion = advance(motion, part, epoch.t_us, config)
        observed, modelled, motion, leapt = self._modelled(observed, motion, core.ionosphere)
        trusted = np.array([name not in core.excluded for name in observed.satellites], dtype=bool)
        used = modelled.select(trusted)
        galileo = observed.galileo[trusted]
        needed = 3 if motion.inertial else 5 + int(0 < galileo.sum() < len(galileo))
        if len(galileo) < needed:
            reason = f"{len(galileo)} healthy satellites above the mask; {needed} are needed"
            return [_untestable(epoch, reason, core)], replace(core, motion=motion)
        rates = check_rates(motion, used, config)
        tested = check_ranges(freed_by(motion, rates.hypothesis), used, galileo, config)
        names = tuple(name for name, ok in zip(observed.satellites, trusted, strict=True) if ok)
        blamed = tuple(names[i] for i in tested.left_out)
        excluded = readmit(
            core.excluded, observed.satellites, modelled, motion.p, epoch.t_us, config
        )
        core = replace(core, excluded=exclude(excluded, blamed, epoch.t_us), ranges_us=epoch.t_us)
        imu_blamed = was_inertial and "imu" in (rates.hypothesis, tested.hypothesis)
        core = self._imu_verdict(core, imu_blamed, epoch.t_us)
        motion = self._with_rates(tested.motion, observed, trusted, rates, core.ionosphere)
        motion = find_attitude(core, motion, part, dt_s, config)
        core = self._unknown(replace(core, motion=motion), tested.hypothesis, epoch.t_us)
        hypothesis = "clock" if leapt and tested.hypothesis == "none" else tested.hypothesis
        if imu_blamed or (core.imu_bad_until_us is not None and hypothesis == "none"):
            hypothesis = "imu"
        elif core.excluded and hypothesis == "none":
            hypothesis = "satellites"
        decision = _decision(epoch, names, used, tested, motion, core, hypothesis)
        decision = msgspec.structs.replace(decision, alarm=tested.alarm or imu_blamed)
        return [decision, *_imu_results(epoch, rates, part, was_inertial, imu_blamed, config)], core

    def _modelled(
        self, observed: Observed, motion: Motion, ionosphere: Vector
    ) -> tuple[Observed, Modelled, Motion, bool]:
        """Satellites above the mask with their innovations; and whether the clock was set."""
        modelled = model(observed, motion.x, self.config.sigma, ionosphere)
        above = modelled.elevation_rad >= np.radians(self.config.mask_deg)
        leap = float(np.median(modelled.v_m[above])) if above.any() else 0.0
        leapt = abs(leap) > CLOCK_LEAP_M
        if leapt:
            x = motion.x.copy()
            x[X_CLOCK] += leap
            motion = free_clock(replace(motion, x=x))
            modelled = model(observed, x, self.config.sigma, ionosphere)
        return observed.select(above), modelled.select(above), motion, leapt

    def _with_rates(
        self,
        motion: Motion,
        observed: Observed,
        trusted: Vector,
        rates: RatesTested,
        ionosphere: Vector,
    ) -> Motion:
        """The filter updated with the rates too, modelled anew after the ranges."""
        if not rates.fit.any():
            return motion
        after = model(observed.select(trusted), motion.x, self.config.sigma, ionosphere)
        return use_rates(motion, after, rates.fit, self.config)

    def _imu_verdict(self, core: Core, blamed: bool, t_us: int) -> Core:
        """The IMU held out for a while once it was blamed."""
        if blamed:
            return replace(core, imu_bad_until_us=t_us + round(self.config.imu_hold_s * 1e6))
        if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
            return replace(core, imu_bad_until_us=None)
        return core

    def _unknown(self, core: Core, hypothesis: str, t_us: int) -> Core:
        """A filter that nothing fits for too long is started anew."""
        if hypothesis != "multiple-unknown":
            return replace(core, unknown_since_us=None) if core.unknown_since_us else core
        since = core.unknown_since_us or t_us
        if (t_us - since) * 1e-6 >= self.config.reset_s:
            return replace(core, motion=None, unknown_since_us=None)
        return replace(core, unknown_since_us=since)


def _learn(core: Core, sample: EphemerisSample) -> Core:
    """The core with one ephemeris more; the same one again changes nothing."""
    ephemeris = sample.ephemeris
    stored = core.ephemerides.get(ephemeris.satellite, ())
    if any(known == ephemeris for known, _ in stored):
        return core
    kept = (*stored[-EPHEMERIDES_KEPT + 1 :], (ephemeris, pack_ephemeris(ephemeris)))
    return replace(core, ephemerides={**core.ephemerides, ephemeris.satellite: kept})


def _imu_results(
    epoch: Epoch,
    rates: RatesTested,
    part: Segment,
    was_inertial: bool,
    blamed: bool,
    config: DetectorConfig,
) -> list[Result]:
    """What the epoch says of the IMU: silence, and the test of the velocity it predicts."""
    if not was_inertial:
        return []
    reason = ""
    if part.gap_s > config.gap_s:
        reason = f"no IMU samples for {part.gap_s:.2f} s"
    elif rates.statistic is None:
        return []
    return [
        SensorDecision(
            t_s=epoch.t_us * 1e-6,
            t_us=epoch.t_us,
            sensor="imu",
            statistic=rates.statistic,
            threshold=rates.threshold,
            dof=rates.dof,
            alarm=bool(reason) or blamed,
            isolated=bool(reason) or blamed,
            reason=reason,
        )
    ]


def _decision(
    epoch: Epoch,
    names: tuple[str, ...],
    used: Modelled,
    tested: Tested,
    motion: Motion,
    core: Core,
    hypothesis: str,
) -> Decision:
    onsets = [entry.onset_us for entry in core.excluded.values()]
    return Decision(
        t_s=epoch.t_us * 1e-6,
        t_us=epoch.t_us,
        statistic=tested.statistic,
        threshold=tested.threshold,
        dof=tested.dof,
        p_value=p_value(tested.statistic, tested.dof),
        alarm=tested.alarm,
        hypothesis=hypothesis,
        excluded=tuple(sorted(core.excluded)),
        satellites=names,
        residual_m=tuple(used.v_m.tolist()),
        normalised=tuple(tested.normalised.tolist()),
        onset_s=max(onsets) * 1e-6 if onsets else None,
        probabilities=tested.probabilities,
        position_ecef_m=_triple(motion.x[:3]),
        position_sigma_m=_triple(np.sqrt(np.diag(motion.p)[:3])),
        mode="inertial" if motion.inertial else "free",
        parity_statistic=tested.parity[0],
        parity_threshold=tested.parity[1],
        parity_dof=tested.parity[2],
    )


def _untestable(epoch: Epoch, reason: str, core: Core) -> Decision:
    return Decision(
        t_s=epoch.t_us * 1e-6,
        t_us=epoch.t_us,
        statistic=None,
        threshold=None,
        dof=0,
        p_value=None,
        alarm=False,
        hypothesis="untestable",
        excluded=tuple(sorted(core.excluded)),
        reason=reason,
    )


def _triple(values: Vector) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
