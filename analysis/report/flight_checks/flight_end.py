"""Checks of the end of a flight: control, ground impact, attitude at rest, log ending in flight."""

import numpy as np

from analysis.report.curves.motor_outputs import FLYING_OUTPUT
from analysis.report.curves.recording import FlightData, Windows
from analysis.report.curves.vehicle_phase import FLYERS
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import (
    FAIL,
    NONE,
    PASS,
    WARN,
    FlightCheck,
    restrict_to_classes,
)
from analysis.report.judging.vehicle_record import vehicle_record
from analysis.scoring.vehicle_outcome import (
    BLOW,
    ENDED_TILTED,
    FLEW_AWAY,
    LOST_CONTROL,
    REST_MPS,
    REST_S,
    STOP_S,
    UPSET_DEG,
    VehicleOutcome,
    VehicleRecord,
    judge_vehicle,
    median_tilt,
)

AIRBORNE_M = 2.0  # chosen: above the noise of a barometric height
FALLING_MPS = 3.0  # chosen: a faster sink at the end of a log is a fall
STILL_MPS2 = 2.0  # an MPU-9250 on a bench changed by 1.5 at most (benchmarks/flight_logs.csv)


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check control, ground impact, attitude at rest, and whether the log ends in flight."""
    record = vehicle_record(recording)
    found = judge_vehicle(record)
    end = _ends_airborne(recording, record)
    checks = _impact(record, found, th), _controlled(found), _upright(record, found), end
    return [restrict_to_classes(check, recording.vehicle, FLYERS) for check in checks]


def _impact(record: VehicleRecord, found: VehicleOutcome, th: Thresholds) -> FlightCheck:
    name, (warn, fail) = "ground impact", th.impact_mps
    limit = f"warn above {warn:g} m/s, fail above {fail:g} m/s"
    if record.motion is None or not record.motion.has_height or record.armed == []:
        reason = "never armed" if record.armed == [] else "no height in the log"
        return FlightCheck(name, NONE, reason, limit)
    speed_mps, at_s = found.impact_mps or 0.0, found.impact_s or 0.0
    blow = next((event for event in found.events if event.text.startswith(BLOW)), None)
    if blow is not None and speed_mps <= fail:
        limit += ", or for a blow that ends the flight"
        window = blow.t_s, blow.t_s + STOP_S
        return FlightCheck(
            name, FAIL, f"{blow.text}, at {blow.t_s:.1f} s", limit, (window,), "accel"
        )
    if speed_mps <= warn:
        slow = "none" if found.impact_s is None else f"touched down at {speed_mps:.1f} m/s"
        return FlightCheck(name, PASS, slow, limit, panel="climb")
    text = f"hit the ground at a sink rate of {speed_mps:.1f} m/s, at {at_s:.1f} s"
    verdict = FAIL if speed_mps >= fail else WARN
    return FlightCheck(name, verdict, text, limit, ((at_s, at_s + STOP_S),), "climb")


def _controlled(found: VehicleOutcome) -> FlightCheck:
    """Check that the vehicle neither lost control nor flew away."""
    name, limit = "control in flight", "fail: thrown over, or flown away"
    if not any(event.kind == "take-off" for event in found.events):
        return FlightCheck(name, NONE, "no take-off in the log", limit)
    lost = [event for event in found.events if event.kind in (LOST_CONTROL, FLEW_AWAY)]
    windows = tuple((event.t_s, event.t_s + REST_S) for event in lost)
    evidence = ", ".join(event.text for event in lost) or "kept"
    return FlightCheck(name, FAIL if lost else PASS, evidence, limit, windows, "tilt")


def _upright(record: VehicleRecord, found: VehicleOutcome) -> FlightCheck:
    """Check that the vehicle ends each flight upright, unless tilted before (tail-sitter)."""
    name, limit = "vehicle ends upright", f"fail: tilted by more than {UPSET_DEG:g}°"
    if found.end_tilt_deg is None or not record.armed:
        unknown = record.motion is None or found.end_tilt_deg is None
        reason = "no attitude in the log" if unknown else "the log does not say when armed"
        return FlightCheck(name, NONE, reason, limit)
    upset = [event for event in found.events if event.text.startswith(ENDED_TILTED)]
    windows = tuple((event.t_s - REST_S, event.t_s + REST_S) for event in upset)
    evidence = ", ".join(event.text for event in upset) or "yes"
    return FlightCheck(name, FAIL if upset else PASS, evidence, limit, windows, "tilt")


def _ends_airborne(recording: FlightData, record: VehicleRecord) -> FlightCheck:
    name, limit = "landing before the log ends", "warn: in flight; fail: falling or upside down"
    motion, armed = record.motion, record.armed
    if motion is None or not motion.has_height or not armed:
        reason = "no height in the log" if armed else "the log does not say when armed"
        return FlightCheck(name, NONE, reason, limit)
    t_s, height_m, end_s = motion.t_s, motion.height_m, float(motion.t_s[-1])
    last = t_s > end_s - 1.0
    height, sink = float(np.median(height_m[last])), float(np.median(motion.sink_mps[last]))
    up = height > np.percentile(height_m, 2) + AIRBORNE_M or abs(sink) > REST_MPS
    # Disarmed before the end, or low and at rest; a height that drifts does not show a flight.
    if armed[-1][1] < recording.duration_s - 1.0 or not up or _lies(recording, record, end_s - 1.0):
        return FlightCheck(name, PASS, "yes", limit)
    tilt = median_tilt(motion, end_s - 1.0, end_s) or 0.0
    # A simulated flight may end in the air: its duration was over.
    mild = PASS if motion.from_truth else WARN
    verdict = FAIL if sink > FALLING_MPS or tilt > UPSET_DEG else mild
    text = (
        f"armed at the end, {height - height_m.min():.0f} m above the lowest height, "
        f"sinking at {sink:.1f} m/s, tilted by {tilt:.0f}°"
    )
    return FlightCheck(name, verdict, text, limit, ((end_s - 1.0, end_s),), "height")


def _lies(recording: FlightData, record: VehicleRecord, since_s: float) -> bool:
    """Whether the ground carries the vehicle: no thrust, and a force that neither changes nor
    vanishes, as it would in a fall."""
    thrusts = [signal._replace(value=signal.value / 100.0) for signal in recording.of("throttle")]
    last = [s.value[s.t_s > since_s] for s in thrusts or recording.of("actuators")]
    if record.force is None or not any(len(v) for v in last):
        return False
    felt = record.force[1][record.force[0] > since_s]
    idle = max(v.max(initial=0.0) for v in last) < FLYING_OUTPUT
    return idle and len(felt) > 1 and bool(np.ptp(felt) < STILL_MPS2 < felt.min())
