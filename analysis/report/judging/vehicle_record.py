"""Collect what a log of any format says about the vehicle, to judge the flight's outcome."""

import numpy as np

from analysis.report.curves.derived_curves import OWN_ATTITUDE
from analysis.report.curves.recording import (
    FlightData,
    Signal,
    Vector,
    Windows,
    merged_windows,
    true_runs,
)
from analysis.report.curves.vehicle_phase import COPTER, FLYERS, HELI, armed_windows
from analysis.report.judging.autopilot_texts import INFORMATION, is_alarming
from analysis.scoring.vehicle_outcome import (
    TimedText,
    VehicleMotion,
    VehicleOutcome,
    VehicleRecord,
    judge_vehicle,
)

TRUTH = "truth"
GRID_S = {True: 0.02, False: 0.1}  # time step of truth and of estimates: fine enough for an impact
ESTIMATES = ("estimate", "controller", "VFR_HUD", "GPS")
TRACKS = ("estimate", "local estimate", "GPS")
LONGEST_S = 1e6  # eleven days; in a log that lasts longer, times are wrong
MOST_STEPS = 500_000  # of a motion, 14 hours of estimates; chosen to limit memory
START_M = 1.0  # chosen: a vehicle that gets lower than this below its start began in the air
# Roll and pitch of a remote control, and its throttle.
STEERING, THROTTLE = ("channel 1", "channel 2"), ("throttle", "channel 3")
CENTRE_US, HALF_RANGE_US = 1500.0, 500.0
STICK_SHARE = 0.1  # chosen: beyond the dead zone, and the trim of a remote control
BRAKED_S = 5.0  # chosen: a vehicle has stopped this long after the sticks are let go


def vehicle_outcome(recording: FlightData) -> VehicleOutcome:
    """Return the outcome of a flight with derived curves."""
    return judge_vehicle(vehicle_record(recording))


def vehicle_record(recording: FlightData) -> VehicleRecord:
    """Collect motion, modes, commands and words from a recording with derived curves."""
    texts = [event for event in recording.events if event.kind in ("text", "error")]
    modes = [span for span in recording.spans if span.lane == "mode"]
    commands = [event for event in recording.events if event.kind == "command"]
    error = recording.curve("position-error", "estimate")
    return VehicleRecord(
        vehicle_motion(recording),
        armed_windows(recording),
        [TimedText(span.start_s, span.text) for span in modes],
        [TimedText(event.t_s, event.text) for event in commands] or None,
        # What is mere information explains no failsafe.
        [TimedText(event.t_s, event.text) for event in texts if not INFORMATION.search(event.text)],
        [TimedText(event.t_s, event.text) for event in texts if is_alarming(event)],
        [TimedText(e.t_s, e.text) for e in recording.events if e.kind == "failsafe"],
        None if error is None else (error.t_s, error.value),
        _tilt_error(recording),
        _felt_force(recording),
        _hovers(recording),
        _steered(recording),
        _lowered(recording),
        recording.vehicle in ("", *FLYERS),
    )


def vehicle_motion(recording: FlightData) -> VehicleMotion | None:
    """The motion by the truth, else by the autopilot's estimate; None without height and tilt."""
    true = _signal(recording, ("altitude", "height"), (TRUTH,))
    height = true or _signal(recording, ("height", "altitude"), ESTIMATES)
    if height is None:
        return _attitude_alone(recording)
    names = (TRUTH,) if true else OWN_ATTITUDE
    step_s = GRID_S[true is not None]
    if not 4 * step_s < height.t_s[-1] - height.t_s[0] < LONGEST_S:
        return None
    step_s = max(step_s, float(height.t_s[-1] - height.t_s[0]) / MOST_STEPS)
    t_s = np.arange(height.t_s[0], height.t_s[-1], step_s)
    height_m = np.interp(t_s, height.t_s, height.value)
    if height.panel == "altitude":
        height_m = height_m - height_m[0]
    from_ground = bool(height_m.min() > -START_M)
    if not from_ground:
        height_m = height_m - height_m.min()
    north_m, east_m = _path(recording, (TRUTH,) if true else TRACKS, t_s)
    return VehicleMotion(
        t_s, height_m, north_m, east_m, _sink(recording, true is not None, t_s, height_m),
        _tilt(recording, names, t_s), true is not None, from_ground,
    )  # fmt: skip


def _attitude_alone(recording: FlightData) -> VehicleMotion | None:
    tilt = _signal(recording, ("tilt",), OWN_ATTITUDE)
    if tilt is None:
        return None
    unknown = np.full(len(tilt.t_s), np.nan)
    return VehicleMotion(tilt.t_s, unknown, unknown, unknown, unknown, tilt.value, False)


def _signal(
    recording: FlightData, panels: tuple[str, ...], names: tuple[str, ...]
) -> Signal | None:
    """The finite values of the first curve with one of the names, in order of the names."""
    for name in names:
        for signal in (signal for panel in panels for signal in recording.of(panel)):
            # More than ten values are needed.
            good = np.isfinite(signal.value)
            if signal.name == name and good.sum() > 10:
                return Signal(signal.panel, name, signal.t_s[good], signal.value[good])
    return None


def _sink(recording: FlightData, true: bool, t_s: Vector, height_m: Vector) -> Vector:
    climbs = [s.name for s in recording.of("climb") if s.name not in (TRUTH, "desired")]
    climb = _signal(recording, ("climb",), (TRUTH,) if true else tuple(climbs))
    if climb is not None:
        return -np.interp(t_s, climb.t_s, climb.value)
    # Smooth over three samples, as differences of heights are noisy.
    smooth = np.convolve(height_m, np.full(3, 1 / 3), "same")
    return -np.gradient(smooth, t_s)


def _path(recording: FlightData, names: tuple[str, ...], t_s: Vector) -> tuple[Vector, Vector]:
    """North and east [m] (n,) of the first position; NaN without a track."""
    track = recording.track(*names)
    if track is None:
        return np.full(len(t_s), np.nan), np.full(len(t_s), np.nan)
    start = float(track.lat_deg[0]), float(track.lon_deg[0])
    north_m, east_m = (
        np.interp(t_s, track.t_s, axis, left=np.nan, right=np.nan)
        for axis in track.metres_from(*start)
    )
    return north_m, east_m


def _tilt(recording: FlightData, names: tuple[str, ...], t_s: Vector) -> Vector:
    tilt = _signal(recording, ("tilt",), names)
    if tilt is None:
        return np.full(len(t_s), np.nan)
    return np.asarray(np.interp(t_s, tilt.t_s, tilt.value, np.nan, np.nan))


def _tilt_error(recording: FlightData) -> tuple[Vector, Vector] | None:
    """The error [deg] of the autopilot's roll and pitch together."""
    roll, pitch = (recording.curve(f"error-{part}", "autopilot") for part in ("roll", "pitch"))
    if roll is None or pitch is None:
        return None
    both = np.hypot(roll.value, np.interp(roll.t_s, pitch.t_s, pitch.value))
    return roll.t_s, np.minimum(both, 180.0)  # both beyond it: upside down


def _felt_force(recording: FlightData) -> tuple[Vector, Vector] | None:
    """The norm of the specific force [m/s^2]; None if not logged in full."""
    axes = {s.name: s for s in recording.of("accel") if s.name in ("x", "y", "z")}
    if len(axes) < 3 or len({len(s.t_s) for s in axes.values()}) > 1:
        return None
    # The norm: the affected axis depends on the attitude.
    return axes["x"].t_s, np.linalg.norm([axes[name].value for name in "xyz"], axis=0)


def _hovers(recording: FlightData) -> bool:
    """Whether the vehicle holds a place in the air; a fixed wing circles around it."""
    # A copter that is guided from outside flies from place to place.
    return recording.vehicle in (COPTER, HELI) and "GUIP" not in recording.messages


def _steered(recording: FlightData) -> Windows:
    """When a pilot moves the vehicle by the sticks of roll and pitch, and until it has braked.

    ArduPilot's LOITER is a pilot's mode, and GUIDED that of a ground station: without the sticks
    or any command in the log they may be steered any time.
    """
    sticks = [(curve, 0.0, STICK_SHARE) for curve in recording.of("sticks")
              if curve.name in ("roll", "pitch")]  # fmt: skip
    sticks = sticks or [(curve, CENTRE_US, STICK_SHARE * HALF_RANGE_US)
                        for curve in recording.of("rc") if curve.name in STEERING]  # fmt: skip
    commands = any(event.kind == "command" for event in recording.events)
    unseen = [mode for mode, seen in (("LOITER", sticks), ("GUIDED", commands)) if not seen]
    unseen = unseen if recording.autopilot == "ardupilot" else []
    found = [(s.start_s, s.end_s) for s in recording.spans if s.text in unseen]
    for curve, centre, least in sticks:
        moved = np.abs(curve.value - centre) > least
        found += [(float(curve.t_s[begin]), float(curve.t_s[end - 1]) + BRAKED_S)
                  for begin, end in true_runs(moved)]  # fmt: skip
    return merged_windows(found)


def _lowered(recording: FlightData) -> Windows:
    """When a pilot holds the throttle below its middle, and until the vehicle has braked."""
    curve = next((s for panel in ("sticks", "rc") for s in recording.of(panel)
                  if s.name in THROTTLE and len(s.t_s)), None)  # fmt: skip
    if curve is None:
        return []
    share = (curve.value - CENTRE_US) / HALF_RANGE_US
    if curve.panel == "sticks":
        # From -1 to 1, before PX4 1.14 from 0 to 1.
        share = curve.value if np.nanmin(curve.value) < 0.0 else 2.0 * curve.value - 1.0
    return [(float(curve.t_s[begin]), float(curve.t_s[end - 1]) + BRAKED_S)
            for begin, end in true_runs(share < -STICK_SHARE)]  # fmt: skip
