"""Without raw ranges: the same tests on a receiver's own position and velocity.

Three position components have no redundancy among themselves, so who lies is told by the velocity
and by whether the receiver agrees with itself: a position that leaves while the velocity still
fits the IMU is the receiver's fault; a velocity that leaves while the receiver's positions move
with it is the IMU's.
"""

from dataclasses import dataclass, replace

import numpy as np

from analysis.fdi.align import find_attitude
from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core, State
from analysis.fdi.exclusion import exclude
from analysis.fdi.inertial import BA, BG, CLOCK, DRIFT, ERRORS, PSI, X_SIZE, correct, innovate
from analysis.fdi.motion import advance, segment, split_pending
from analysis.fdi.ranges import free_position
from analysis.fdi.start import ACCEL_BIAS_SIGMA_MPS2, GYRO_BIAS_SIGMA_RPS
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square, p_value
from analysis.gnss import ned_axes
from analysis.results import Decision, Result, SensorDecision
from analysis.samples import GpsFix, Vector
from simvehicle.earth import ecef_from_geodetic

RECEIVER = "GPS"  # the receiver's name among what is excluded
FIX_3D = 3
POSITION_SIGMA_M = (1.0, 1.5)  # horizontal, vertical; where the receiver claims less
UNKNOWN_SIGMA_M = 3.0
VELOCITY_SIGMA_MPS = (0.3, 0.4)
LOST_M = 300.0  # a filter as unsure as this is started anew


@dataclass(frozen=True, slots=True)
class Measured:
    """A fix in ECEF: position and variance along north, east, down; velocity where known."""

    r_ecef_m: Vector
    axes: Vector
    variance_m2: Vector
    v_ned_mps: Vector | None


@dataclass(frozen=True, slots=True)
class Check:
    """One chi-square test; `v`, `h` and `variance` are what an update would use."""

    statistic: float
    threshold: float
    v: Vector
    h: Vector
    variance: Vector

    @property
    def passes(self) -> bool:
        """Whether the fix fits the prediction."""
        return self.statistic <= self.threshold


def step_position(fix: GpsFix, state: State, config: DetectorConfig) -> tuple[list[Result], State]:
    """The decision on one fix and the next state."""
    core, pending = state
    if core.gps_source not in (None, fix.source) and fix.source != "HIL_GPS":
        return [], state
    core = replace(core, gps_source=fix.source)
    measured, reason = measure(fix)
    motion = core.motion
    if measured is None:
        return [_untestable(fix, reason)], State(core, pending)
    if motion is not None:
        since_s = (fix.t_us - motion.t_us) * 1e-6
        if -config.reset_s < since_s <= 0.0:
            return [_untestable(fix, f"time went back by {-since_s:.3f} s")], State(core, pending)
        if not 0.0 < since_s <= config.reset_s or np.sqrt(motion.p[0, 0]) > LOST_M:
            motion = None
    run, pending = split_pending(pending, fix.t_us)
    if motion is None:
        core = replace(core, motion=_start(fix.t_us, measured), excluded={}, last_fix=None)
        return [_decision(fix, core, None, None, "none", False, "start")], State(core, pending)
    part = segment(run, motion, fix.t_us)
    predicted, _ = advance(motion, part, fix.t_us, config)
    position, velocity = check(measured, predicted, config)
    hypothesis, alarm = _judge(core, measured, fix.t_us, predicted, position, velocity, config)
    core = _with_hysteresis(core, hypothesis, position, fix.t_us, config)
    moved = _used(predicted, core, hypothesis, measured, position, velocity, config)
    dt_s = (fix.t_us - motion.t_us) * 1e-6
    moved = find_attitude(core, moved, part, dt_s, config)
    core = replace(core, motion=moved, last_fix=(fix.t_us, measured.r_ecef_m))
    shown = hypothesis
    if hypothesis == "none" and RECEIVER in core.excluded:
        shown = "gps"
    elif hypothesis == "none" and core.imu_bad_until_us is not None:
        shown = "imu"
    mode = "position" if moved.inertial else "position-free"
    results = [_decision(fix, core, position, velocity, shown, alarm, mode)]
    gap = part.gap_s if predicted.inertial or motion.inertial else 0.0
    return [*results, *_sensors(fix, core, position, velocity, gap, hypothesis, config)], State(
        core, pending
    )


def measure(fix: GpsFix) -> tuple[Measured | None, str]:
    """The fix in ECEF, or why it cannot be used."""
    if fix.fix_type < FIX_3D:
        return None, f"fix type {fix.fix_type}; 3 or more is a position"
    if not np.isfinite([fix.lat_deg, fix.lon_deg, fix.alt_m]).all():
        return None, "the position is not finite"
    if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
        return None, "the position is 0, 0"
    lat, lon = np.radians(fix.lat_deg), np.radians(fix.lon_deg)
    sigma = [
        max(claimed, floor) if np.isfinite(claimed) and claimed > 0.0 else UNKNOWN_SIGMA_M
        for claimed, floor in zip((fix.eph_m, fix.epv_m), POSITION_SIGMA_M, strict=True)
    ]
    variance = np.array([sigma[0], sigma[0], sigma[1]]) ** 2
    r_ecef_m = np.asarray(ecef_from_geodetic(lat, lon, fix.alt_m))
    return Measured(r_ecef_m, ned_axes(float(lat), float(lon)), variance, fix.v_ned_mps), ""


def check(measured: Measured, motion: Motion, config: DetectorConfig) -> tuple[Check, Check | None]:
    """Test position, and velocity where it is known, against the prediction."""
    h = np.zeros((3, ERRORS))
    h[:, 0:3] = measured.axes
    v = measured.axes @ (measured.r_ecef_m - motion.x[0:3])
    position = _check(motion.p, v, h, measured.variance_m2, config.p_false_alarm)
    if measured.v_ned_mps is None:
        return position, None
    known = np.isfinite(measured.v_ned_mps)
    if not known.any():
        return position, None
    h = np.zeros((3, ERRORS))
    h[:, 3:6] = measured.axes
    v = measured.v_ned_mps - measured.axes @ motion.x[3:6]
    sigma = np.array([VELOCITY_SIGMA_MPS[0], *VELOCITY_SIGMA_MPS])
    return position, _check(motion.p, v[known], h[known], sigma[known] ** 2, config.p_other)


def _check(p: Vector, v: Vector, h: Vector, variance: Vector, p_false_alarm: float) -> Check:
    _, _, _, q = innovate(p, np.ascontiguousarray(h), variance, v)
    return Check(q, chi_square(len(v), p_false_alarm), v, h, variance)


def _judge(
    core: Core,
    measured: Measured,
    t_us: int,
    motion: Motion,
    position: Check,
    velocity: Check | None,
    config: DetectorConfig,
) -> tuple[str, bool]:
    """Whose fault a failed test is, and whether it is an alarm."""
    if position.passes and (velocity is None or velocity.passes):
        return "none", False
    if not motion.inertial:  # nothing but steady motion predicts: a jump of position it is, or none
        return ("none", False) if _self_consistent(core, measured, t_us, config) else ("gps", True)
    if velocity is None or velocity.passes:
        return "gps", True
    if _self_consistent(core, measured, t_us, config):
        return "imu", True
    return ("gps", True) if position.passes else ("multiple-unknown", True)


def _self_consistent(core: Core, measured: Measured, t_us: int, config: DetectorConfig) -> bool:
    """Whether the receiver's position moved as its velocity says since the last fix."""
    if core.last_fix is None or measured.v_ned_mps is None:
        return True
    dt_s = (t_us - core.last_fix[0]) * 1e-6
    known = np.isfinite(measured.v_ned_mps)
    moved = measured.axes @ (measured.r_ecef_m - core.last_fix[1])
    difference = (moved - np.nan_to_num(measured.v_ned_mps) * dt_s)[known]
    variance = 0.5**2 + (VELOCITY_SIGMA_MPS[0] ** 2 + config.noise.motion_mps2**2 * dt_s) * dt_s**2
    q = float(difference @ difference) / variance
    return q <= chi_square(int(known.sum()), config.p_other)


def _with_hysteresis(
    core: Core, hypothesis: str, position: Check, t_us: int, config: DetectorConfig
) -> Core:
    """The receiver left out or back in; the IMU held out for a while."""
    if hypothesis == "imu":
        return replace(core, imu_bad_until_us=t_us + round(config.imu_hold_s * 1e6))
    if core.imu_bad_until_us is not None and t_us >= core.imu_bad_until_us:
        core = replace(core, imu_bad_until_us=None)
    if hypothesis in ("gps", "multiple-unknown"):
        left = exclude(core.excluded, (RECEIVER,), t_us, t_us)
        return replace(
            core, excluded={**left, RECEIVER: replace(left[RECEIVER], healthy_since_us=None)}
        )
    entry = core.excluded.get(RECEIVER)
    if entry is None or not position.passes:
        return core
    since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
    if (t_us - since) * 1e-6 >= config.readmit_s:
        return replace(core, excluded={})
    return replace(core, excluded={RECEIVER: replace(entry, healthy_since_us=since)})


def _used(
    motion: Motion,
    core: Core,
    hypothesis: str,
    measured: Measured,
    position: Check,
    velocity: Check | None,
    config: DetectorConfig,
) -> Motion:
    """The filter after what is trusted of the fix."""
    if hypothesis == "imu" or (hypothesis == "none" and not position.passes):
        motion = free_position(motion)
        position, velocity = check(measured, motion, config)
    if RECEIVER not in core.excluded and position.passes:
        motion = _updated(motion, position)
    if velocity is not None and velocity.passes:
        again = check(measured, motion, config)[1]
        motion = _updated(motion, again if again is not None else velocity)
    return motion


def _updated(motion: Motion, part: Check) -> Motion:
    h = np.ascontiguousarray(part.h)
    ph, m, u, _ = innovate(motion.p, h, part.variance, part.v)
    x, p, _ = correct(motion.x, motion.p, h, part.variance, ph, m, u)
    return replace(motion, x=x, p=p)


def _start(t_us: int, measured: Measured) -> Motion:
    x, p = np.zeros(X_SIZE), np.zeros((ERRORS, ERRORS))
    x[0:3], x[6] = measured.r_ecef_m, 1.0
    p[0:3, 0:3] = measured.axes.T @ np.diag(measured.variance_m2) @ measured.axes
    known = measured.v_ned_mps is not None and np.isfinite(measured.v_ned_mps).all()
    if measured.v_ned_mps is not None:
        x[3:6] = measured.axes.T @ np.nan_to_num(measured.v_ned_mps)
    speed = 2.0 * VELOCITY_SIGMA_MPS[1] if known else 10.0
    parts = ((3, speed), (PSI, 3.0), (BG, GYRO_BIAS_SIGMA_RPS), (BA, ACCEL_BIAS_SIGMA_MPS2))
    for at, sigma in parts:
        p[range(at, at + 3), range(at, at + 3)] = sigma**2
    p[CLOCK, CLOCK] = p[DRIFT, DRIFT] = 1.0
    return Motion(t_us, x, p)


def _decision(
    fix: GpsFix,
    core: Core,
    position: Check | None,
    velocity: Check | None,
    hypothesis: str,
    alarm: bool,
    mode: str,
) -> Decision:
    motion = core.motion
    assert motion is not None
    sigma = np.sqrt(np.diag(motion.p)[:3])
    return Decision(
        t_s=fix.t_us * 1e-6,
        t_us=fix.t_us,
        statistic=position.statistic if position else None,
        threshold=position.threshold if position else None,
        dof=3 if position else 0,
        p_value=p_value(position.statistic, 3) if position else None,
        alarm=alarm,
        hypothesis=hypothesis,
        excluded=tuple(sorted(core.excluded)),
        position_ecef_m=(float(motion.x[0]), float(motion.x[1]), float(motion.x[2])),
        position_sigma_m=(float(sigma[0]), float(sigma[1]), float(sigma[2])),
        residual_m=tuple(position.v.tolist()) if position else (),
        mode=mode,
    )


def _sensors(
    fix: GpsFix,
    core: Core,
    position: Check,
    velocity: Check | None,
    gap_s: float,
    hypothesis: str,
    config: DetectorConfig,
) -> list[Result]:
    """The same in the form of the other sensors' verdicts, and a silent IMU."""
    results: list[Result] = []
    blamed = hypothesis == "gps" or RECEIVER in core.excluded
    for sensor, part in (("gps-position", position), ("gps-velocity", velocity)):
        if part is not None:
            results.append(
                SensorDecision(
                    t_s=fix.t_us * 1e-6,
                    t_us=fix.t_us,
                    sensor=sensor,
                    statistic=part.statistic,
                    threshold=part.threshold,
                    dof=len(part.v),
                    alarm=not part.passes,
                    isolated=blamed and not part.passes,
                )
            )
    silent = gap_s > config.gap_s
    if silent or hypothesis == "imu":
        results.append(
            SensorDecision(
                t_s=fix.t_us * 1e-6,
                t_us=fix.t_us,
                sensor="imu",
                statistic=velocity.statistic if velocity and not silent else None,
                threshold=velocity.threshold if velocity and not silent else None,
                dof=len(velocity.v) if velocity and not silent else 0,
                alarm=True,
                isolated=True,
                reason=f"no IMU samples for {gap_s:.2f} s" if silent else "",
            )
        )
    return results


def _untestable(fix: GpsFix, reason: str) -> Decision:
    return Decision(
        t_s=fix.t_us * 1e-6,
        t_us=fix.t_us,
        statistic=None,
        threshold=None,
        dof=0,
        p_value=None,
        alarm=False,
        hypothesis="untestable",
        reason=reason,
    )
