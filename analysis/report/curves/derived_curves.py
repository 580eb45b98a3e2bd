"""Compute derived curves: position steps, errors against the truth, divergence, motor balance."""

from dataclasses import replace

import numpy as np

from analysis.report.curves.fused_curves import error_ned_m, fused_errors
from analysis.report.curves.motor_outputs import balance_curves
from analysis.report.curves.recording import Event, FlightData, GroundTrack, Signal, Vector
from mavproxy_fault.numerics.rotations.rotation import wrap_degrees

OWN_ATTITUDE = ("ATTITUDE", "ATTITUDE_QUATERNION")
LONG_STEP_S = 3.0  # chosen: over a longer interval a jump cannot be distinguished from motion
RESET_M = 5.0  # chosen: a larger step of an estimate is a filter reset
LEAST_SAMPLES, EVEN_SHARE = 100, 0.8  # of a log for the interval curve


def add_derived_curves(recording: FlightData) -> FlightData:
    """Add derived signals and events to a recording."""
    signals, events = derive_curves(recording)
    return replace(
        recording,
        signals=recording.signals + signals,
        events=sorted(recording.events + events, key=lambda event: event.t_s),
    )


def derive_curves(recording: FlightData) -> tuple[list[Signal], list[Event]]:
    """Compute derived signals and events of a recording."""
    signals, events = [], []
    for track in recording.tracks:
        # The truth is exempt; two steps need three points.
        if track.name.startswith("truth") or len(track.t_s) < 3:
            continue
        step = step_beyond_speed(track, recording.curve("speed", track.name, "ground"))
        is_gps = "GPS" in track.name or "GNSS" in track.name
        panel = "gps-jump" if is_gps else "estimate-jump"
        signals.append(Signal(panel, track.name, track.t_s[1:], step))
        if not is_gps:
            # A receiver may jump due to a fault; a jump of an estimate is a filter reset.
            events.extend(_resets(track, step))
    signals.extend(_position_errors(recording))
    signals.extend(fused_errors(recording))
    signals.extend(_attitude_errors(recording))
    signals.extend(_divergence(recording))
    signals.extend(balance_curves(recording))
    signals.extend(_intervals(recording))
    signals.extend(_tilt(recording))
    return signals, events


def step_beyond_speed(track: GroundTrack, speed_mps: Signal | None) -> Vector:
    """Length of each step of a track beyond what its speed explains, m; shape (n - 1,)."""
    before = track.lat_deg[:-1], track.lon_deg[:-1]
    length = np.hypot(*track.select(slice(1, None)).metres_from(*before))
    dt = np.diff(track.t_s)
    flown = np.zeros_like(length)
    if speed_mps is not None:
        good = np.isfinite(speed_mps.value)
        if good.any():
            at = np.interp(track.t_s, speed_mps.t_s[good], speed_mps.value[good])
            # The higher speed of both ends bounds the motion.
            flown = np.maximum(at[1:], at[:-1]) * dt
    beyond: Vector = np.maximum(length - flown, 0.0)
    # Steps over a long gap are not judged.
    beyond[dt > LONG_STEP_S] = np.nan
    return beyond


def _resets(track: GroundTrack, step: Vector) -> list[Event]:
    far = np.flatnonzero(np.nan_to_num(step) > RESET_M)
    return [
        Event(
            float(track.t_s[i + 1]),
            "reset",
            f"position {track.name} jumps by {step[i]:.0f} m",
            4,
        )
        for i in far.tolist()
    ]


def _position_errors(recording: FlightData) -> list[Signal]:
    found, truth = [], recording.track("truth")
    for track in recording.tracks:
        if truth is None or track is truth or track.on_earth != truth.on_earth:
            continue
        t_s, error = error_ned_m(track, truth)
        if len(t_s) > 1:
            level = np.hypot(error[:, 0], error[:, 1])
            found.append(Signal("position-error", track.name, t_s, level))
    return found


def _attitude_errors(recording: FlightData) -> list[Signal]:
    """Attitude errors: the autopilot's estimate minus the truth, and minus the setpoint."""
    found = []
    for part in ("roll", "pitch", "yaw"):
        own = recording.curve(part, *OWN_ATTITUDE)
        true, desired = recording.curve(part, "truth"), recording.curve(part, "desired")
        if own and true:
            found.append(_difference(f"error-{part}", "autopilot", own, true))
        # Yaw may lag its setpoint without harm, and wraps.
        if own and desired and part != "yaw":
            found.append(_difference("control-error", part, own, desired))
    # A curve needs two samples.
    found = [signal for signal in found if len(signal.t_s) > 1]
    control = [signal for signal in found if signal.panel == "control-error"]
    # The tilt needs both angles.
    if len(control) == 2:
        roll, pitch = control
        there = np.interp(roll.t_s, pitch.t_s, pitch.value)
        found.append(Signal("control-error", "tilt", roll.t_s, np.hypot(roll.value, there)))
    return found


def _difference(panel: str, name: str, own: Signal, other: Signal) -> Signal:
    """One angle minus another where both are known, in degrees within (-180, 180]."""
    inside = (own.t_s >= other.t_s[0]) & (own.t_s <= other.t_s[-1])
    t_s = own.t_s[inside]
    # Unwrapped: interpolation from 179 to -179 degrees must not pass 0.
    there = np.interp(t_s, other.t_s, np.unwrap(other.value, period=360))
    return Signal(panel, name, t_s, wrap_degrees(own.value[inside] - there))


def _divergence(recording: FlightData) -> list[Signal]:
    """Angle in degrees between the down direction of each further estimator instance and that of
    the first. Unlike roll and pitch it has no singularity."""
    angles = [recording.of(f"instance-{part}") for part in ("roll", "pitch")]
    found = []
    # `strict=False`: an instance may lack one of the angles.
    for roll, pitch in list(zip(*angles, strict=False))[1:]:
        first = _down(angles[0][0], angles[1][0], roll.t_s)
        sine = np.linalg.norm(np.cross(first, further := _down(roll, pitch, roll.t_s)), axis=1)
        lean = np.degrees(np.arctan2(sine, (first * further).sum(axis=1)))
        found.append(Signal("divergence", roll.name, roll.t_s, lean))
    return found


def _down(roll: Signal, pitch: Signal, t_s: Vector) -> Vector:
    """Down direction in body axes (n, 3) at times (n,), from angles in degrees."""
    # Unwrapped: interpolation from 179 to -179 degrees must not pass 0.
    r = np.radians(np.interp(t_s, roll.t_s, np.unwrap(roll.value, period=360)))
    p = np.radians(np.interp(t_s, pitch.t_s, pitch.value))
    return np.column_stack((-np.sin(p), np.sin(r) * np.cos(p), np.cos(r) * np.cos(p)))


def _tilt(recording: FlightData) -> list[Signal]:
    """Tilt: angle between the body z axis and the vertical, of the autopilot's estimate and of the
    truth."""
    rolls, pitches = ({s.name: s for s in recording.of(part)} for part in ("roll", "pitch"))
    both = [name for name in OWN_ATTITUDE if name in rolls.keys() & pitches.keys()]
    found = []
    for name in [*both[:1], *({"truth"} & rolls.keys() & pitches.keys())]:
        roll, pitch = rolls[name], pitches[name]
        # The cosines, which have no step at 180 degrees.
        level = np.interp(roll.t_s, pitch.t_s, np.cos(np.radians(pitch.value)))
        level = np.clip(level * np.cos(np.radians(roll.value)), -1.0, 1.0)
        found.append(Signal("tilt", name, roll.t_s, np.degrees(np.arccos(level))))
    return found


def _intervals(recording: FlightData) -> list[Signal]:
    """Intervals between logged gyroscope samples, which show gaps and uneven logging."""
    signal = next(iter(recording.of("gyro")), None)
    if signal is None or len(signal.t_s) < LEAST_SAMPLES:
        return []
    step_s = np.diff(signal.t_s)
    # Intervals of a thinned log are meaningless.
    if np.mean(step_s < 2.0 * np.median(step_s)) < EVEN_SHARE:
        return []
    return [Signal("interval", "gyroscope", signal.t_s[1:], step_s * 1e3)]
