"""The named signals of a flight for requirements, from its recording, labels and results."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from analysis.report.curves.recording import FlightData, Vector
from analysis.report.judging.vehicle_record import GRID_S, TRUTH, vehicle_record
from analysis.results import AttitudeError, Result
from analysis.scoring.requirements import TRUE, FlightSignals, Requirement, RequirementResult
from analysis.scoring.vehicle_outcome import (
    AIRBORNE_M,
    CRASHED,
    FAILSAFE,
    LANDING_MODES,
    VehicleMotion,
    VehicleOutcome,
    VehicleRecord,
    judge_vehicle,
)
from mavproxy_fault.wire.label import Label

CLIMB_MPS = 0.3  # chosen: a take-off ends when the vehicle climbs slower than this
HELD_S = 1.0  # an alarm counts for the interval of GNSS epochs, the slowest that are tested
SILENT_S = 1.0  # chosen: a receiver that is silent for five of its epochs is lost
FIX_3D = 3  # GPS_FIX_TYPE
# ArduCopter's FENCE_RADIUS and FENCE_ALT_MAX; the parameters in the log count first.
FENCE = (
    (("FENCE_RADIUS", "GF_MAX_HOR_DIST"), 300.0),
    (("FENCE_ALT_MAX", "GF_MAX_VER_DIST"), 100.0),
)


def judge_requirements(
    requirements: Sequence[Requirement],
    recording: FlightData,
    labels: Sequence[Label] = (),
    results: Iterable[Result] = (),
    ground_m: float | None = None,
    subject: str = "",
) -> list[RequirementResult]:
    """Judge a flight by its recording with derived curves, its labels and results.

    `ground_m` is the true altitude of the ground; without it heights count from the start. The
    attitude error is that of the estimator `subject`, if it is one.
    """
    if not requirements:
        return []
    signals = collect_signals(recording, labels, results, ground_m, subject)
    if signals is None:
        reason = "the recording holds neither the true state nor an altitude"
        return [
            RequirementResult(name=one.label, formula=one.formula, met=None,
                              reason=reason) for one in requirements
        ]  # fmt: skip
    return [one.judge(signals) for one in requirements]


def collect_signals(
    recording: FlightData,
    labels: Sequence[Label],
    results: Iterable[Result],
    ground_m: float | None = None,
    subject: str = "",
) -> FlightSignals | None:
    """Put all signals on the time grid of the motion; None without a motion."""
    record = vehicle_record(recording)
    motion = record.motion
    if motion is None or not motion.has_height:
        return None
    true = recording.curve("altitude", TRUTH)
    if ground_m is not None and motion.from_truth and true is not None:
        height_m = np.interp(motion.t_s, true.t_s, true.value) - ground_m
        motion = motion._replace(height_m=height_m, from_ground=True)
    # A vehicle of the simulator flies without being armed.
    record = record._replace(motion=motion, armed=record.armed or None if true else record.armed)
    found, grid = judge_vehicle(record), _Grid(motion.t_s)
    high = motion.t_s[motion.height_m > AIRBORNE_M]
    flown = (float(high[0]), float(high[-1])) if len(high) else (np.inf, np.inf)
    start_s = _end_of_climb(motion, flown[0])
    faults = [_window_s(label) for label in labels]
    alarms, attitudes = _monitored(results, recording.t0_us)
    values = {
        **_motion_signals(recording, motion, grid),
        **_event_flags(record, found, flown, grid),
        "impact_mps": np.where(grid.t_s >= (found.impact_s or 0.0), found.impact_mps or 0.0, 0.0),
        "position_error_m": grid.curve(record.errors_m),
        "attitude_error_deg": grid.curve(record.errors_deg),
        "taking_off": grid.flags([(flown[0], start_s)]),
        "gps_lost": grid.flags(_gps_lost(recording, float(grid.t_s[-1]))),
        "fault": grid.flags(faults),
        "detected": grid.flags((at_s, at_s + HELD_S) for at_s in alarms),
        **{f"{name}__attitude_error_deg": grid.curve(curve) for name, curve in attitudes.items()},
    }
    if (own := f"{subject.replace('-', '_')}__attitude_error_deg") in values:
        values["attitude_error_deg"] = values[own]
    mode_at = np.full(len(grid.t_s), "", object)
    for name, begin_s, end_s in record.mode_spans():
        mode_at[(grid.t_s >= begin_s) & (grid.t_s < end_s)] = name
    fault_s = min((start for start, _ in faults), default=None)
    return FlightSignals(grid.t_s, values, mode_at.tolist(), start_s, fault_s)


class _Grid(NamedTuple):
    """The times (n,) of all signals [s]."""

    t_s: Vector

    def curve(self, curve: tuple[Vector, Vector] | None) -> Vector:
        """A curve at the times (n,), NaN outside it."""
        if curve is None or len(curve[0]) < 2:
            return np.full(len(self.t_s), np.nan)
        return np.interp(self.t_s, *curve, left=np.nan, right=np.nan)

    def flags(self, windows: Iterable[tuple[float, float]]) -> Vector:
        """True within the windows."""
        active = np.zeros(len(self.t_s), bool)
        for start_s, end_s in windows:
            active |= (self.t_s >= start_s) & (self.t_s < end_s)
        return np.where(active, TRUE, -TRUE)


def _motion_signals(recording: FlightData, motion: VehicleMotion, grid: _Grid) -> dict[str, Vector]:
    distance_m = np.hypot(motion.north_m, motion.east_m)
    radius_m, top_m = (
        next(
            (values[-1][1] for name in names if (values := recording.parameters.get(name))
             and values[-1][1] > 0.0), default,
        )
        for names, default in FENCE
    )  # fmt: skip
    margin_m = np.minimum(radius_m - distance_m, top_m - motion.height_m)
    names = (TRUTH,) if motion.from_truth else ("ground", "GPS")
    speed = recording.curve("speed", *names)
    return {
        "height_m": motion.height_m,
        "north_m": motion.north_m,
        "east_m": motion.east_m,
        "distance_m": distance_m,
        "speed_mps": grid.curve((speed.t_s, speed.value) if speed else None),
        "climb_mps": -motion.sink_mps,
        "tilt_deg": motion.tilt_deg,
        "fence_margin_m": margin_m,
        "inside_fence": margin_m,
    }


def _event_flags(
    record: VehicleRecord, found: VehicleOutcome, flown: tuple[float, float], grid: _Grid
) -> dict[str, Vector]:
    modes = record.mode_spans()
    touched = any(event.kind == "touchdown" for event in found.events)
    landed = [(-np.inf, flown[0]), *([(flown[1], np.inf)] if touched else [])]
    # A failsafe lasts until the next change of the mode.
    failsafes = [
        (e.t_s, next((begin for _, begin, _ in modes if begin > e.t_s + 0.1), np.inf))
        for e in found.events
        if e.kind == FAILSAFE
    ]
    landing = [(begin, end) for name, begin, end in modes if name in LANDING_MODES]
    return {
        "armed": grid.flags(record.armed or ()),
        "landing": grid.flags([*landing, *landed]),
        "landed": grid.flags(landed),
        "failsafe": grid.flags(failsafes),
        "crashed": grid.flags((e.t_s, np.inf) for e in found.events if e.kind == CRASHED),
        "warned": grid.flags((alarm.t_s, alarm.t_s + HELD_S) for alarm in record.alarms),
    }


def _end_of_climb(motion: VehicleMotion, took_off_s: float) -> float:
    """The time at which the vehicle stops climbing after its take-off; a fall ends it too."""
    steps = max(1, round(1.0 / GRID_S[motion.from_truth]))
    smooth_mps = np.convolve(-motion.sink_mps, np.full(steps, 1.0 / steps), "same")
    # Half a second later, when the vehicle has left the ground.
    after = np.flatnonzero((motion.t_s >= took_off_s + 0.5) & (smooth_mps < CLIMB_MPS))
    if not np.isfinite(took_off_s) or not len(after) or took_off_s == motion.t_s[0]:
        return float(took_off_s)
    return float(motion.t_s[after[0]])


def _window_s(label: Label) -> tuple[float, float]:
    end_s = np.inf if label.end_us is None else (label.end_us - label.t0_us) * 1e-6
    return (label.start_us - label.t0_us) * 1e-6, end_s


def _monitored(
    results: Iterable[Result], t0_us: int
) -> tuple[list[float], dict[str, tuple[Vector, Vector]]]:
    """Times of the monitor's alarms, and the attitude error of each estimator, from `t0_us`."""
    alarms, errors = [], dict[str, list[Any]]()
    for result in results:
        at_s = (result.t_us - t0_us) * 1e-6
        if isinstance(result, AttitudeError):
            # An estimate of NaN is as wrong as possible.
            angle = result.angle if np.isfinite(result.angle) else 180.0
            errors.setdefault(result.estimator.replace("-", "_"), []).append((at_s, angle))
        elif getattr(result, "alarm", False):
            alarms.append(at_s)
    return alarms, {name: tuple(np.array(rows).T) for name, rows in errors.items()}


def _gps_lost(recording: FlightData, end_s: float) -> list[tuple[float, float]]:
    """When the receiver had no 3D fix or was silent, by what the autopilot was sent."""
    sent = recording.messages.get("HIL_GPS") or recording.messages.get("GPS_RAW_INT")
    if sent is None:
        return []
    good_s = sent.t_s[sent.columns["fix_type"] >= FIX_3D]
    edges = (
        np.array([*good_s.tolist(), end_s + SILENT_S]) if len(good_s) else np.array([0.0, end_s])
    )
    gaps = np.flatnonzero(np.diff(edges) > SILENT_S)
    return [(float(edges[i] + SILENT_S), float(edges[i + 1])) for i in gaps]
