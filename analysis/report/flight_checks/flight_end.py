"""How a flight ended: on the ground at which speed, or with the log in the air."""

import numpy as np
from numpy.typing import NDArray

from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck, Windows
from analysis.report.recordings.recording import FlightData, Signal, Vector
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

STOP_S = 0.7  # within which the ground stops a fall
REST_S = 2.0  # for which the vehicle then lies
REST_MPS, REST_M = 1.0, 2.0
IMPACT_MPS2 = 15.0  # beyond gravity: no multirotor brakes so hard
GRID_STEP_S = 0.1  # of the axis on which it is judged
AIRBORNE_M = 2.0
FALLING_MPS = 3.0
UPSET_DEG = 60.0
ESTIMATES = ("estimate", "CTUN", "GPS")


def checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """The impact on the ground, how the vehicle then lies, and whether the log ends in flight."""
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
    for i in np.flatnonzero(sink_mps > warn):
        # A little after disarming: the autopilot itself disarms on an impact.
        inside = armed is None or any(a <= t_s[i] <= b + REST_S for a, b in armed)
        if sink_mps[i] > worst and inside and _stopped(recording, t_s, height_m, sink_mps, int(i)):
            worst, at_s = float(sink_mps[i]), float(t_s[i])
    if worst == 0.0:
        return FlightCheck(name=name, verdict=PASS, evidence="none", limit=limit, panel="climb")
    return FlightCheck(
        name=name,
        verdict=FAIL if worst > fail else WARN,
        evidence=f"stopped by the ground at {worst:.1f} m/s of sink, at {at_s:.1f} s",
        limit=limit,
        windows=((at_s, at_s + STOP_S),),
        panel="climb",
    )


def _upright(recording: FlightData, armed: Windows | None) -> FlightCheck:
    """Whether the vehicle ends each flight as it stood before; a tail-sitter may stand on end."""
    name, limit = "vehicle ends upright", f"fail: tilted by more than {UPSET_DEG:g}°"
    tilt = next(iter(recording.of("tilt")), None)
    if tilt is None or not armed:
        reason = "no attitude in the log" if tilt is None else "the log does not say when armed"
        return FlightCheck(name=name, verdict=NONE, evidence=reason, limit=limit)
    fallen = {
        (end - REST_S, end + REST_S): lies
        for start, end in armed
        # Around disarming, which the autopilot does by itself after a crash.
        if (lies := _tilt(tilt, end - REST_S / 2, end + REST_S / 2)) > UPSET_DEG
        and _tilt(tilt, start - REST_S / 2, start + REST_S / 2) < UPSET_DEG
    }
    worst = max(fallen.values(), default=0.0)
    return FlightCheck(
        name=name,
        verdict=FAIL if fallen else PASS,
        evidence=f"tilted by {worst:.0f}° when disarmed or cut off" if fallen else "it does",
        limit=limit,
        windows=tuple(fallen),
        panel="tilt",
    )


def _motion(recording: FlightData) -> tuple[Vector, Vector, Vector] | None:
    """Time, height and sink rate on an even axis; None where no height was logged."""
    heights = [*recording.of("height"), *recording.of("altitude")]
    height = _first(heights)
    if height is None:
        return None
    t_s = np.arange(height.t_s[0], height.t_s[-1], GRID_STEP_S)
    height_m = np.interp(t_s, height.t_s, height.value)
    climb = _first(recording.of("climb"))
    if climb is not None:
        return t_s, height_m, -np.interp(t_s, climb.t_s, climb.value)
    # Three samples of smoothing: the difference of heights is noisy.
    smooth = np.convolve(height_m, np.full(3, 1 / 3), "same")
    return (t_s, height_m, -np.gradient(smooth, GRID_STEP_S)) if len(t_s) > 3 else None


def _first(signals: list[Signal]) -> Signal | None:
    """The autopilot's own estimate, else a receiver's, with the numbers that are some."""
    for name in ESTIMATES:
        for signal in signals:
            # A curve of a few numbers is none.
            good = np.isfinite(signal.value)
            if signal.name == name and good.sum() > 10:
                return Signal(signal.panel, name, signal.t_s[good], signal.value[good])
    return None


def _stopped(
    recording: FlightData, t_s: Vector, height_m: Vector, sink_mps: Vector, at: int
) -> bool:
    """Whether a fall ends within a moment, near the lowest place, for good or with a blow."""
    stop, rest = at + round(STOP_S / GRID_STEP_S), at + round(REST_S / GRID_STEP_S)
    if stop >= len(t_s) or np.abs(sink_mps[at : stop + 1]).min() > REST_MPS:
        return False
    lies = np.ptp(height_m[stop : rest + 1]) < REST_M
    # Near the lowest place of the flight: the log may not begin there.
    low = height_m[stop] < np.percentile(height_m, 2) + 2 * AIRBORNE_M
    blow = _felt_impact(recording, t_s[at], t_s[stop])
    return bool(lies and low and blow is not False)


def _felt_impact(recording: FlightData, begin_s: float, end_s: float) -> bool | None:
    """Whether the accelerometers felt it; None where they were not logged often enough."""
    axes = {s.name: s for s in recording.of("accel") if s.name in ("x", "y", "z")}
    if len(axes) < 3 or len({len(s.t_s) for s in axes.values()}) > 1:
        return None
    # Axes of different length cannot be added.
    t_s = axes["x"].t_s
    near: NDArray[np.bool_] = (t_s >= begin_s - 0.3) & (t_s <= end_s + 0.3)
    if near.sum() < 10:
        return None
    force = np.linalg.norm([axes[name].value[near] for name in "xyz"], axis=0)
    # The size alone: which axis feels the ground depends on the attitude.
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
    # Disarmed well before the end, or low and at rest.
    if armed[-1][1] < recording.duration_s - 1.0 or not up:
        return FlightCheck(name=name, verdict=PASS, evidence="it does", limit=limit)
    tilt = next((_tilt(s, s.t_s[-1] - 1.0, s.t_s[-1]) for s in recording.of("tilt")), 0.0)
    return FlightCheck(
        name=name,
        verdict=FAIL if sink > FALLING_MPS or tilt > UPSET_DEG else WARN,
        evidence=f"armed at the end, {height - height_m.min():.0f} m above the lowest place, "
        f"sinking at {sink:.1f} m/s, tilted by {tilt:.0f}°",
        limit=limit,
        windows=((float(t_s[-1]) - 1.0, float(t_s[-1])),),
        panel="height",
    )


def _tilt(signal: Signal, start_s: float, end_s: float) -> float:
    """The usual tilt within a stretch, degrees; 0 without a sample."""
    inside = signal.value[(signal.t_s >= start_s) & (signal.t_s <= end_s)]
    inside = inside[np.isfinite(inside)]
    return float(np.median(inside)) if len(inside) else 0.0
