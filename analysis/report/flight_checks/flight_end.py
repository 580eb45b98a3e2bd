"""Checks of the end of a flight: ground impact, attitude at rest, log ending in flight."""

import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import FlightData, Signal, Vector
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck, Windows
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

STOP_S = 0.7  # chosen: the ground stops a fall within this time
REST_S = 2.0  # chosen: the vehicle then stays at rest this long
REST_MPS, REST_M = 1.0, 2.0  # chosen: a vehicle at rest, within the noise of estimates
IMPACT_MPS2 = 15.0  # beyond gravity; chosen: a multirotor does not brake this hard
LONGEST_S = 1e6  # eleven days; in a log that lasts longer, times are wrong
GRID_STEP_S = 0.1  # time step of the resampled height
AIRBORNE_M = 2.0  # chosen: above the noise of a barometric height
FALLING_MPS = 3.0  # chosen: a faster sink at the end of a log is a fall
UPSET_DEG = 60.0  # chosen: beyond the tilt of controlled flight and uneven ground
ESTIMATES = ("estimate", "CTUN", "VFR_HUD", "GPS")
FALL_MPS2 = 1.5 * STANDARD_GRAVITY_MPS2  # a datum that steps "falls" faster than any vehicle
FALL_STEPS = 3  # over these many steps


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check the ground impact, the attitude at rest, and whether the log ends in flight."""
    return [
        _impact(recording, th, armed),
        _upright(recording, armed),
        _ends_airborne(recording, armed),
    ]


def _impact(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    name, (warn, fail) = "ground impact", th.impact_mps
    limit = f"warn above {warn:g} m/s, fail above {fail:g} m/s"
    motion = _motion(recording)
    if motion is None or armed == []:
        reason = "never armed" if armed == [] else "no height in the log"
        return FlightCheck(name=name, verdict=NONE, evidence=reason, limit=limit)
    t_s, height_m, sink_mps = motion
    worst, at_s = 0.0, 0.0
    sped_up = np.diff(sink_mps, n=1, prepend=sink_mps[:1])
    gained_mps = np.convolve(sped_up, np.ones(FALL_STEPS), "full")[: len(sink_mps)]
    falls = gained_mps <= FALL_MPS2 * FALL_STEPS * GRID_STEP_S
    for i in np.flatnonzero((sink_mps > warn) & falls):
        # Also shortly after disarming: the autopilot disarms on an impact.
        inside = armed is None or any(a <= t_s[i] <= b + REST_S for a, b in armed)
        if sink_mps[i] > worst and inside and _stopped(recording, t_s, height_m, sink_mps, int(i)):
            worst, at_s = float(sink_mps[i]), float(t_s[i])
    if worst == 0.0:
        return FlightCheck(name=name, verdict=PASS, evidence="none", limit=limit, panel="climb")
    return FlightCheck(
        name=name,
        verdict=FAIL if worst > fail else WARN,
        evidence=f"hit the ground at a sink rate of {worst:.1f} m/s, at {at_s:.1f} s",
        limit=limit,
        windows=((at_s, at_s + STOP_S),),
        panel="climb",
    )


def _upright(recording: FlightData, armed: Windows | None) -> FlightCheck:
    """Check that the vehicle ends each flight upright, unless tilted before (tail-sitter)."""
    name, limit = "vehicle ends upright", f"fail: tilted by more than {UPSET_DEG:g}°"
    tilt = next(iter(recording.of("tilt")), None)
    if tilt is None or not armed:
        reason = "no attitude in the log" if tilt is None else "the log does not say when armed"
        return FlightCheck(name=name, verdict=NONE, evidence=reason, limit=limit)
    fallen = {
        (end - REST_S, end + REST_S): lies
        for start, end in armed
        # Around disarming: the autopilot disarms after a crash.
        if (lies := _tilt(tilt, end - REST_S / 2, end + REST_S / 2)) > UPSET_DEG
        and _tilt(tilt, start - REST_S / 2, start + REST_S / 2) < UPSET_DEG
    }
    worst = max(fallen.values(), default=0.0)
    return FlightCheck(
        name=name,
        verdict=FAIL if fallen else PASS,
        evidence=f"tilted by {worst:.0f}° when disarmed or at the end" if fallen else "yes",
        limit=limit,
        windows=tuple(fallen),
        panel="tilt",
    )


def _motion(recording: FlightData) -> tuple[Vector, Vector, Vector] | None:
    """Time, height and sink rate at equal time steps; None without a logged height."""
    heights = [*recording.of("height"), *recording.of("altitude")]
    height = _first(heights)
    if height is None:
        return None
    if not 4 * GRID_STEP_S < height.t_s[-1] - height.t_s[0] < LONGEST_S:
        return None
    t_s = np.arange(height.t_s[0], height.t_s[-1], GRID_STEP_S)
    height_m = np.interp(t_s, height.t_s, height.value)
    climb = _first(recording.of("climb"))
    if climb is not None:
        return t_s, height_m, -np.interp(t_s, climb.t_s, climb.value)
    # Smooth over three samples, as differences of heights are noisy.
    smooth = np.convolve(height_m, np.full(3, 1 / 3), "same")
    return (t_s, height_m, -np.gradient(smooth, GRID_STEP_S)) if len(t_s) > 3 else None


def _first(signals: list[Signal]) -> Signal | None:
    """The finite values of the autopilot's estimate, else of a receiver."""
    for name in ESTIMATES:
        for signal in signals:
            # More than ten values are needed.
            good = np.isfinite(signal.value)
            if signal.name == name and good.sum() > 10:
                return Signal(signal.panel, name, signal.t_s[good], signal.value[good])
    return None


def _stopped(
    recording: FlightData, t_s: Vector, height_m: Vector, sink_mps: Vector, at: int
) -> bool:
    """Whether a fall ends within `STOP_S` at the lowest height, at rest, with an impact."""
    stop, rest = at + round(STOP_S / GRID_STEP_S), at + round(REST_S / GRID_STEP_S)
    if stop >= len(t_s) or np.abs(sink_mps[at : stop + 1]).min() > REST_MPS:
        return False
    lies = np.ptp(height_m[stop : rest + 1]) < REST_M
    # Relative to the lowest height of the flight: the log may begin in the air.
    low = height_m[stop] < np.percentile(height_m, 2) + 2 * AIRBORNE_M
    blow = _felt_impact(recording, t_s[at], t_s[stop])
    return bool(lies and low and blow is not False)


def _felt_impact(recording: FlightData, begin_s: float, end_s: float) -> bool | None:
    """Whether the accelerometers measured an impact; None if logged too rarely."""
    axes = {s.name: s for s in recording.of("accel") if s.name in ("x", "y", "z")}
    if len(axes) < 3 or len({len(s.t_s) for s in axes.values()}) > 1:
        return None
    # All axes have the same length here.
    t_s = axes["x"].t_s
    near: NDArray[np.bool_] = (t_s >= begin_s - 0.3) & (t_s <= end_s + 0.3)
    if near.sum() < 10:
        return None
    force = np.linalg.norm([axes[name].value[near] for name in "xyz"], axis=0)
    # The norm: the affected axis depends on the attitude.
    return bool(np.nanmax(np.abs(force - STANDARD_GRAVITY_MPS2)) > IMPACT_MPS2)


def _ends_airborne(recording: FlightData, armed: Windows | None) -> FlightCheck:
    name, limit = "log ends on the ground", "warn: in flight; fail: falling or upside down"
    motion = _motion(recording)
    if motion is None or not armed:
        reason = "no height in the log" if motion is None else "the log does not say when armed"
        return FlightCheck(name=name, verdict=NONE, evidence=reason, limit=limit)
    t_s, height_m, sink_mps = motion
    last = t_s > t_s[-1] - 1.0
    height, sink = float(np.median(height_m[last])), float(np.median(sink_mps[last]))
    up = height > np.percentile(height_m, 2) + AIRBORNE_M or abs(sink) > REST_MPS
    # Disarmed before the end, or low and at rest.
    if armed[-1][1] < recording.duration_s - 1.0 or not up:
        return FlightCheck(name=name, verdict=PASS, evidence="yes", limit=limit)
    tilt = next((_tilt(s, s.t_s[-1] - 1.0, s.t_s[-1]) for s in recording.of("tilt")), 0.0)
    return FlightCheck(
        name=name,
        verdict=FAIL if sink > FALLING_MPS or tilt > UPSET_DEG else WARN,
        evidence=f"armed at the end, {height - height_m.min():.0f} m above the lowest height, "
        f"sinking at {sink:.1f} m/s, tilted by {tilt:.0f}°",
        limit=limit,
        windows=((float(t_s[-1]) - 1.0, float(t_s[-1])),),
        panel="height",
    )


def _tilt(signal: Signal, start_s: float, end_s: float) -> float:
    """The median tilt within a time span, degrees; 0 without a sample."""
    inside = signal.value[(signal.t_s >= start_s) & (signal.t_s <= end_s)]
    inside = inside[np.isfinite(inside)]
    return float(np.median(inside)) if len(inside) else 0.0
