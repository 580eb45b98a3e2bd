"""What happened to the vehicle in one flight: a word, the evidence, and the chain of events.

The input is a `VehicleRecord`, which `analysis.report.judging.vehicle_record` takes from a log of
any format, so that run, campaign and report come to one verdict. Motion comes from the truth where
the log has one, else from the autopilot's own estimate.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

Vector = NDArray[np.float64]

AS_COMMANDED, UNAFFECTED, DETECTED, DEGRADED = (
    "landed as commanded", "unaffected", "detected", "degraded",
)  # fmt: skip
UNCOMMANDED, FAILSAFE, FLEW_AWAY = "landed uncommanded", "failsafe", "flew away"
LOST_CONTROL, CRASHED, NOT_JUDGED = "lost control", "crashed", "not judged"
VEHICLE_OUTCOMES = (
    AS_COMMANDED, UNAFFECTED, DETECTED, DEGRADED, UNCOMMANDED, FAILSAFE, FLEW_AWAY, LOST_CONTROL,
    CRASHED,
)  # fmt: skip
BAD_ENDS = (FLEW_AWAY, LOST_CONTROL, CRASHED)
CRASH_MPS = 3.0  # 10 ft/s: the fastest touchdown that landing gear is designed for (14 CFR 23.473)
UPSET_DEG = 60.0  # PX4's failure detector: FD_FAIL_R, FD_FAIL_P
LOST_TILT_DEG = 75.0  # UPSET_DEG and a quarter: a manoeuvre may overshoot the former
AWAY_M = 200.0  # from 30 m/s an autopilot brakes at 2.5 m/s^2 within 180 m
DEGRADED_M, DEGRADED_DEG = 10.0, 5.0  # the defaults of campaigns (analysis/campaign/outcomes.py)
AIRBORNE_M = 1.0  # above a barometer's error (BMP388 data sheet, table 2: 8 Pa, 0.66 m)
GROUND_M = 0.3  # true height of a vehicle on its legs, and an estimate's change in 1 s at rest
BEFORE_S = 0.3  # the speed is taken this long before contact, since contact itself stops the fall
STOP_S = 0.7  # BEFORE_S, and four samples of a log at 10 Hz
REST_S = 2.0  # as long as ArduPilot's crash check waits
REST_MPS, REST_M = 1.0, 2.0  # ArduPilot's land detector: LAND_DETECTOR_VEL_Z_MAX; 2 s of half of it
LOW_M = 4.0  # above the lowest height of a flight: twice REST_M
IMPACT_MPS2 = 15.0  # beyond gravity: thrust of twice the weight brakes at 9.8
BLOW_MPS2, BLOW_FACTOR = 60.0, 2.0  # four times IMPACT_MPS2, and twice what was before
BLOW, ENDED_TILTED = "impact", "ended tilted by"
FALL_MPS2 = 1.5 * STANDARD_GRAVITY_MPS2  # a datum that steps "falls" faster than any vehicle
FALL_STEPS = 3  # over these many steps
COMMAND_S = 3.0  # in which a mode follows its command: three of the heartbeats that report it
# In which an autopilot explains a change of mode: two of its heartbeats, which show a mode late;
# what it says after the heartbeat explains what follows
REASON_S, LATE_REASON_S = 2.0, 0.5
# None matches a setting ("Crash check disabled"), the end of a failsafe, or PX4's mere warning.
CRASH_TEXT = re.compile(r"\bcrash(:|ed\b| detected| check\b(?!.*(dis|en)abled))", re.IGNORECASE)
# ArduPilot's simulator reports every touchdown, with its speed.
HIT_GROUND = re.compile(r"hit ground(?: at (-?\d+(?:\.\d+)?))?", re.IGNORECASE)
FAILSAFE_TEXT = re.compile(
    r"fail-?safe(?!.*(clear|off|recover|resolved|disabled|enabled|deactivated|set to|warning))",
    re.IGNORECASE,
)
SAFETY_MODES = frozenset(
    ("LAND", "RTL", "SMART_RTL", "AUTO_RTL", "BRAKE", "TERMINATION", "CIRCLE", "ALT_HOLD", "QLAND",
     "QRTL", "DESCEND", "ALTCTL", "STABILIZED")
)  # fmt: skip
HOLD_MODES = frozenset(("LAND", "LOITER", "BRAKE", "GUIDED", "DESCEND"))  # it stays in its place
ACROBATIC_MODES = frozenset(("ACRO", "FLIP", "RATTITUDE", "MANUAL", "THROW"))
PILOT_MODES = frozenset(  # in which a pilot's throttle commands the descent
    ("MANUAL", "STABILIZE", "STABILIZED", "ACRO", "RATTITUDE", "ALT_HOLD", "ALTCTL", "LOITER",
     "POSHOLD", "POSCTL", "POSITION SLOW", "SPORT", "DRIFT", "TRAINING", "FBWA", "FBWB", "CRUISE",
     "QSTABILIZE", "QHOVER", "QLOITER", "QACRO")
)  # fmt: skip
LANDING_MODES = frozenset(("LAND", "RTL", "SMART_RTL", "AUTO_RTL", "QLAND", "QRTL", "PRECLAND"))


class VehicleMotion(NamedTuple):
    """Motion of a vehicle: times (n,) [s], height, north and east (n,) [m] from the first position,
    sink rate (n,) [m/s] and tilt (n,) [deg]; NaN where unknown. Unless the flight began
    `from_ground`, the height of the ground is unknown: heights are from the lowest."""

    t_s: Vector
    height_m: Vector
    north_m: Vector
    east_m: Vector
    sink_mps: Vector
    tilt_deg: Vector
    from_truth: bool
    from_ground: bool = True

    @property
    def has_height(self) -> bool:
        """Whether any height is known; some logs have the attitude alone."""
        return bool(np.isfinite(self.height_m).any())


class TimedText(NamedTuple):
    """A message of the autopilot, a mode it entered, or a command that it received."""

    t_s: float
    text: str


class VehicleRecord(NamedTuple):
    """What a log says of a vehicle.

    `commands` are those of an operator that change the mode; None if the log cannot hold any.
    `errors_m`, `errors_deg` are the errors of the autopilot's estimates as (times, values).
    `alarms` are the autopilot's warnings, `force` is the accelerometers' norm.
    `expelled` are changes of mode that the log itself calls a failsafe; a vehicle that `hovers`
    stays in its place in some modes, but while it is `steered`; while a pilot has `lowered` the
    throttle it is to descend. Unless it `flies` it rises and sinks without taking off and
    landing.
    """

    motion: VehicleMotion | None
    armed: Sequence[tuple[float, float]] | None = None
    modes: Sequence[TimedText] = ()
    commands: Sequence[TimedText] | None = None
    texts: Sequence[TimedText] = ()
    alarms: Sequence[TimedText] = ()
    expelled: Sequence[TimedText] = ()
    errors_m: tuple[Vector, Vector] | None = None
    errors_deg: tuple[Vector, Vector] | None = None
    force: tuple[Vector, Vector] | None = None
    hovers: bool = False
    steered: Sequence[tuple[float, float]] = ()
    lowered: Sequence[tuple[float, float]] = ()
    flies: bool = True

    def mode_spans(self) -> list[tuple[str, float, float]]:
        """Each mode with its begin and end [s]; the last one has no end."""
        ends_s = [*(mode.t_s for mode in self.modes[1:]), np.inf]
        return [(mode.text, mode.t_s, end) for mode, end in zip(self.modes, ends_s, strict=False)]


class VehicleEvent(msgspec.Struct, frozen=True):
    """One event of a flight; `kind` is one of `VEHICLE_OUTCOMES`, take-off or touchdown, in a
    campaign one of `outcomes.RANKS`."""

    t_s: float
    kind: str
    text: str = ""


class VehicleOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of a flight: its word, the measures behind it, and the events in order.

    `source` says what the motion was taken from. `failsafe` is the mode of the first failsafe,
    `reason` the autopilot's own words for it.
    """

    outcome: str
    source: str
    impact_mps: float | None = None
    impact_s: float | None = None
    end_tilt_deg: float | None = None
    excursion_m: float | None = None
    excursion_deg: float | None = None
    failsafe: str = ""
    failsafe_s: float | None = None
    reason: str = ""
    events: list[VehicleEvent] = []


def outcome_rank(outcome: str) -> int:
    """Return 0 for the best outcome, more for worse ones, and -1 for one that is not judged."""
    return VEHICLE_OUTCOMES.index(outcome) if outcome in VEHICLE_OUTCOMES else -1


def judge_vehicle(record: VehicleRecord) -> VehicleOutcome:
    """Return the outcome of a flight: the worst of its events."""
    motion = record.motion
    flown = flown_window(record)
    said = [
        VehicleEvent(round(t_s, 3), CRASHED, text)
        for t_s, text in record.texts
        if is_crash_text(text)
    ]
    # Where the log does not say when armed, a vehicle that never moved may just lie there.
    unknown = record.armed is None and record.flies and motion and not motion.has_height
    tested = motion is not None and bool(record.armed or flown or unknown)
    end_tilt_deg, upset = _find_upset(record, motion) if motion and tested else (None, [])
    # One that acts on the ground, before the take-off or behind a crash, is one too.
    acting = record.armed or ([flown] if flown else [])
    failsafes = find_failsafes(record, acting)
    first = next(iter(failsafes), None)
    mode, _, reason = first.text.partition(": ") if first else ("", "", "")
    judged = VehicleOutcome(
        outcome=NOT_JUDGED, source="autopilot's estimate" if upset else "autopilot's messages",
        end_tilt_deg=end_tilt_deg, failsafe=mode, failsafe_s=first.t_s if first else None,
        reason=reason,
    )  # fmt: skip
    if motion is None or flown is None:
        events = sorted([*said, *upset, *failsafes], key=lambda event: event.t_s)
        worst = max((event.kind for event in events), key=outcome_rank, default=NOT_JUDGED)
        return msgspec.structs.replace(judged, outcome=worst, events=events)
    contact, ground = _find_impacts(record, motion, flown)
    excursion_m, away_s, departed = _find_departure(record, motion, flown)
    error_deg = _largest(record.errors_deg, flown)
    error_m = max(excursion_m, _largest(record.errors_m, flown))
    events = [*said, *ground, *upset, *failsafes, *departed, *_find_tumble(record, motion, flown)]
    blow = _find_blow(record, motion)
    events += blow
    crashed = bool(said or ground or upset or blow)
    events += _find_touchdown(record, motion, flown, explained=bool(failsafes) or crashed)
    alarms = [alarm for alarm in record.alarms if flown[0] <= alarm.t_s <= flown[1]]
    events += [VehicleEvent(round(alarm.t_s, 3), DETECTED, alarm.text) for alarm in alarms[:1]]
    if error_m > DEGRADED_M or error_deg > DEGRADED_DEG:
        events.append(_largest_excursion(record, flown, away_s, (error_m, error_deg)))
    events.append(VehicleEvent(round(flown[0], 3), "take-off"))
    events.sort(key=lambda event: event.t_s)
    landed = any(event.kind == "touchdown" for event in events)
    best = AS_COMMANDED if landed else UNAFFECTED
    return msgspec.structs.replace(
        judged,
        outcome=max([best, *(event.kind for event in events)], key=outcome_rank),
        source="truth" if motion.from_truth else "autopilot's estimate",
        impact_mps=None if contact is None else round(contact[1], 2),
        impact_s=None if contact is None else round(contact[0], 3),
        excursion_m=round(excursion_m, 2),
        excursion_deg=round(error_deg, 2),
        events=events,
    )


def is_crash_text(text: str) -> bool:
    """Whether an autopilot reports a crash in these words."""
    hit = HIT_GROUND.search(text)
    if hit is not None:
        return hit[1] is None or abs(float(hit[1])) > CRASH_MPS
    return bool(CRASH_TEXT.search(text))


def flown_window(record: VehicleRecord) -> tuple[float, float] | None:
    """First and last time in the air [s]; None if the vehicle never took off."""
    motion = record.motion
    if motion is None or record.armed == [] or not record.flies:
        return None
    airborne = motion.height_m > AIRBORNE_M
    if record.armed:
        inside = np.zeros(len(motion.t_s), bool)
        for start_s, end_s in record.armed:
            inside |= (motion.t_s >= start_s) & (motion.t_s <= end_s + REST_S)
        airborne &= inside
    where = np.flatnonzero(airborne)
    return (float(motion.t_s[where[0]]), float(motion.t_s[where[-1]])) if len(where) else None


def _find_impacts(
    record: VehicleRecord, motion: VehicleMotion, flown: tuple[float, float]
) -> tuple[tuple[float, float] | None, list[VehicleEvent]]:
    """Return the fastest touchdown (time, speed), None without one, and the first crash."""
    contacts = _touches(motion, flown) if motion.from_truth and motion.from_ground else []
    contacts += _stopped_falls(record, motion)
    events = [
        VehicleEvent(round(t_s, 3), CRASHED, f"hit the ground at {speed_mps:.1f} m/s")
        for t_s, speed_mps in contacts
        if speed_mps > CRASH_MPS
    ]
    return max(contacts, key=lambda contact: contact[1], default=None), events[:1]


def _touches(motion: VehicleMotion, flown: tuple[float, float]) -> list[tuple[float, float]]:
    """Times [s] and sink rates [m/s] of contacts with level ground at the height of the start."""
    low = (motion.height_m < GROUND_M) & (motion.t_s > flown[0])
    entered = np.flatnonzero(low[1:] & ~low[:-1]) + 1
    found = []
    for at in entered.tolist():
        t_s = motion.t_s[at]
        around = (motion.t_s >= t_s - BEFORE_S) & (motion.t_s <= t_s + BEFORE_S)
        after = (motion.t_s > t_s) & (motion.t_s <= t_s + STOP_S)
        # A vehicle that started in the air falls through its first height without a stop.
        if after.any() and float(motion.sink_mps[after].min()) < REST_MPS:
            found.append((float(t_s), float(motion.sink_mps[around].max())))
    return found


def _stopped_falls(record: VehicleRecord, motion: VehicleMotion) -> list[tuple[float, float]]:
    """The fastest fall that ends at the lowest height, at rest, with an impact: (time, speed)."""
    t_s, sink_mps = motion.t_s, motion.sink_mps
    # Relative to the lowest height of the flight: the log may begin in the air.
    low_m = float(np.percentile(motion.height_m, 2)) + LOW_M
    found = []
    falls = np.ones(len(t_s), bool)
    if not motion.from_truth:
        sped_up = np.convolve(np.diff(sink_mps, prepend=sink_mps[:1]), np.ones(FALL_STEPS), "full")
        falls = sped_up[: len(t_s)] <= FALL_MPS2 * FALL_STEPS * np.median(np.diff(t_s))
    for at in np.flatnonzero((sink_mps > CRASH_MPS * 2.0 / 3.0) & falls).tolist():
        # Also shortly after disarming: the autopilot disarms on an impact.
        inside = record.armed is None or any(
            start <= t_s[at] <= end + REST_S for start, end in record.armed
        )
        if inside and _is_stopped(record, motion, at, low_m):
            found.append((float(t_s[at]), float(sink_mps[at])))
    return [max(found, key=lambda fall: fall[1])] if found else []


def _is_stopped(record: VehicleRecord, motion: VehicleMotion, at: int, low_m: float) -> bool:
    """Whether a fall ends within `STOP_S` at the lowest height, at rest, with an impact."""
    t_s, height_m = motion.t_s, motion.height_m
    stop, rest = np.searchsorted(t_s, (t_s[at] + STOP_S, t_s[at] + REST_S)).tolist()
    if stop >= len(t_s) or np.abs(motion.sink_mps[at : stop + 1]).min() > REST_MPS:
        return False
    lies = np.ptp(height_m[stop : rest + 1]) < REST_M
    if not (lies and height_m[stop] < low_m):
        return False
    if record.force is None:
        return True
    at_s, force_mps2 = record.force
    near = (at_s >= t_s[at] - BEFORE_S) & (at_s <= t_s[stop] + BEFORE_S)
    # Logged too rarely, the accelerometers do not contradict.
    beyond_mps2 = np.abs(force_mps2[near] - STANDARD_GRAVITY_MPS2)
    return bool(near.sum() < 10 or np.nanmax(beyond_mps2) > IMPACT_MPS2)


def _find_blow(record: VehicleRecord, motion: VehicleMotion) -> list[VehicleEvent]:
    """The first blow while armed, beyond what this IMU showed before, that ends the flight: the
    motors are cut or the attitude is lost."""
    if record.force is None or not record.armed:
        return []
    t_s, force_mps2 = record.force
    beyond = np.nan_to_num(np.abs(force_mps2 - STANDARD_GRAVITY_MPS2))
    for at in np.flatnonzero(beyond > BLOW_MPS2).tolist():
        blow_s = float(t_s[at])
        ends = [end for start, end in record.armed if start + REST_S < blow_s <= end + STOP_S]
        before = beyond[:at][t_s[:at] < blow_s - STOP_S]
        if not ends or (len(before) and beyond[at] < BLOW_FACTOR * np.quantile(before, 0.999)):
            continue
        around = np.abs(motion.t_s - blow_s) < REST_S
        lost = bool(np.any(motion.tilt_deg[around] > LOST_TILT_DEG))
        cut = ends[0] - blow_s < REST_S and not _touches_down(motion, blow_s)
        if lost or cut:
            what = "with the attitude lost" if lost else "then the motors were cut"
            text = f"{BLOW} of {beyond[at]:.0f} m/s², {what}"
            return [VehicleEvent(round(blow_s, 3), CRASHED, text)]
    return []


def _touches_down(motion: VehicleMotion, t_s: float) -> bool:
    """Whether the vehicle came down slowly and steadily to its lowest height."""
    before = (motion.t_s > t_s - 1.0) & (motion.t_s < t_s - BEFORE_S)
    after = (motion.t_s > t_s) & (motion.t_s < t_s + STOP_S)
    if not before.any() or not after.any():
        return False
    sink_mps = float(np.median(motion.sink_mps[before]))
    low = motion.height_m[after].min() < np.nanmin(motion.height_m) + AIRBORNE_M
    return bool(BEFORE_S < sink_mps < CRASH_MPS and low)


def _find_upset(
    record: VehicleRecord, motion: VehicleMotion
) -> tuple[float | None, list[VehicleEvent]]:
    """Return the tilt [deg] at the end, and a crash where a flight ends tilted over."""
    t_s = motion.t_s
    windows = record.armed or [(float(t_s[0]), float(t_s[-1]))]
    end_deg, events = None, []
    for start_s, end_s in windows:
        # Around disarming: the autopilot disarms after a crash. A tail-sitter starts upright too.
        end_deg = median_tilt(motion, end_s - REST_S / 2.0, end_s + REST_S / 2.0)
        before_deg = median_tilt(motion, start_s - REST_S / 2.0, start_s + REST_S / 2.0)
        if end_deg is not None and end_deg > UPSET_DEG and not (before_deg or 0.0) > UPSET_DEG:
            events.append(VehicleEvent(round(end_s, 3), CRASHED, f"{ENDED_TILTED} {end_deg:.0f}°"))
    last_deg = median_tilt(motion, float(t_s[-1]) - REST_S / 2.0, float(t_s[-1]))
    if record.motion and motion.from_truth and last_deg is not None:
        # The truth does not end with the autopilot's arming.
        end_deg = last_deg
        if last_deg > UPSET_DEG and not events:
            text = f"{ENDED_TILTED} {last_deg:.0f}°"
            events.append(VehicleEvent(round(float(t_s[-1]), 3), CRASHED, text))
    return None if end_deg is None else round(end_deg, 1), events


def median_tilt(motion: VehicleMotion, start_s: float, end_s: float) -> float | None:
    """Return the median tilt [deg] within a time span; None if unknown."""
    inside = motion.tilt_deg[(motion.t_s >= start_s) & (motion.t_s <= end_s)]
    inside = inside[np.isfinite(inside)]
    return float(np.median(inside)) if len(inside) else None


def _find_tumble(
    record: VehicleRecord, motion: VehicleMotion, flown: tuple[float, float]
) -> list[VehicleEvent]:
    """The first time in the air at which the vehicle was thrown over."""
    over = (motion.tilt_deg > LOST_TILT_DEG) & (motion.height_m > AIRBORNE_M)
    over &= (motion.t_s >= flown[0]) & (motion.t_s <= flown[1])
    for at in np.flatnonzero(over).tolist():
        t_s = float(motion.t_s[at])
        if mode_at(record, t_s) not in ACROBATIC_MODES:
            text = f"tilted by {motion.tilt_deg[at]:.0f}° in the air"
            return [VehicleEvent(round(t_s, 3), LOST_CONTROL, text)]
    return []


def mode_at(record: VehicleRecord, t_s: float) -> str:
    """Return the mode at a time, empty if unknown."""
    return next((mode.text for mode in reversed(record.modes) if mode.t_s <= t_s), "")


def find_failsafes(
    record: VehicleRecord, acting: Sequence[tuple[float, float]]
) -> list[VehicleEvent]:
    """Modes that the autopilot entered by itself while armed, each with its own words, and
    failsafes that it reports without a change of mode."""
    said = [text for text in record.texts if FAILSAFE_TEXT.search(text.text)]
    found = []
    for previous, mode in zip(record.modes, record.modes[1:], strict=False):
        if not is_within(mode.t_s, acting) or mode.text == previous.text:
            continue
        if _is_near(mode.t_s, record.commands or (), -COMMAND_S, 0.1):
            continue
        reasons, own = (
            [text for text in texts if -REASON_S <= text.t_s - mode.t_s <= LATE_REASON_S]
            for texts in (said, record.expelled)
        )
        # Without a record of commands only the autopilot's texts separate failsafes from commands.
        unasked = record.commands is not None and mode.text in SAFETY_MODES
        if reasons or own or unasked:
            words = ", ".join(dict.fromkeys(text.text for text in (*reasons, *own)))
            found.append(VehicleEvent(round(mode.t_s, 3), FAILSAFE, f"{mode.text}: {words}"))
    marked = [TimedText(event.t_s, event.text) for event in found]
    for text in (*said, *record.expelled):
        if is_within(text.t_s, acting) and not _is_near(text.t_s, marked, -60.0, REASON_S):
            mode_name = mode_at(record, text.t_s) or "no change of mode"
            found.append(VehicleEvent(round(text.t_s, 3), FAILSAFE, f"{mode_name}: {text.text}"))
            marked.append(text)
    return sorted(found, key=lambda event: event.t_s)


def is_within(t_s: float, windows: Sequence[tuple[float, float]] | None) -> bool:
    """Whether an instant is within any of the windows (None: always)."""
    return windows is None or any(start_s <= t_s <= end_s for start_s, end_s in windows)


def _is_near(t_s: float, marks: Sequence[TimedText], from_s: float, to_s: float) -> bool:
    return any(t_s + from_s <= mark.t_s <= t_s + to_s for mark in marks)


def _find_departure(
    record: VehicleRecord, motion: VehicleMotion, flown: tuple[float, float]
) -> tuple[float, float, list[VehicleEvent]]:
    """Return how far [m] and when [s] the vehicle left the place that its mode holds, and when it
    flew away from there or from where it believes to be."""
    farthest_m, left_s, events = 0.0, flown[1], []
    held = [span for span in record.mode_spans() if record.hovers and span[0] in HOLD_MODES]
    for _, begin_s, end_s in held:
        start_s, end_s = max(begin_s, flown[0]), min(end_s, flown[1])
        inside = (motion.t_s >= start_s) & (motion.t_s <= end_s) & np.isfinite(motion.north_m)
        if not inside.any():
            continue
        north_m, east_m, t_s = motion.north_m[inside], motion.east_m[inside], motion.t_s[inside]
        steered = np.zeros(len(t_s), bool)
        for begin_s, stop_s in record.steered:
            steered |= (t_s >= begin_s) & (t_s <= stop_s)
        # The place that is held is where a pilot last let it go.
        begun = np.maximum.accumulate(np.where(steered, np.arange(len(t_s)), 0))
        apart_m = np.hypot(north_m - north_m[begun], east_m - east_m[begun])
        farthest_m = max(farthest_m, float(apart_m.max()))
        left_s = min(left_s, *t_s[apart_m > DEGRADED_M][:1].tolist(), flown[1])
        events += _departure(t_s, apart_m, "left its place")
    if record.errors_m is not None:
        t_s, error_m = _within(record.errors_m, flown)
        # An estimate that jumps is no excursion of a vehicle that keeps its place.
        begun = np.maximum.accumulate(np.where(error_m > REST_M, 0, np.arange(len(t_s))))
        north_m, east_m = (np.interp(t_s, motion.t_s, m) for m in (motion.north_m, motion.east_m))
        moved_m = np.hypot(north_m - north_m[begun], east_m - east_m[begun])
        apart_m = np.minimum(error_m, moved_m)
        farthest_m = max(farthest_m, float(np.nanmax(apart_m, initial=0.0)))
        events += _departure(t_s, apart_m, "left its estimate")
    return farthest_m, left_s, events[:1]


def _departure(t_s: Vector, apart_m: Vector, text: str) -> list[VehicleEvent]:
    far = np.flatnonzero(apart_m > AWAY_M)
    if not len(far):
        return []
    return [
        VehicleEvent(round(float(t_s[far[0]]), 3), FLEW_AWAY, f"{text} by {apart_m.max():.0f} m")
    ]


def _within(curve: tuple[Vector, Vector], window: tuple[float, float]) -> tuple[Vector, Vector]:
    t_s, value = curve
    inside = (t_s >= window[0]) & (t_s <= window[1]) & np.isfinite(value)
    return t_s[inside], np.abs(value[inside])


def _largest(curve: tuple[Vector, Vector] | None, window: tuple[float, float]) -> float:
    return 0.0 if curve is None else float(_within(curve, window)[1].max(initial=0.0))


def _largest_excursion(
    record: VehicleRecord,
    flown: tuple[float, float],
    left_s: float,
    largest: tuple[float, float],
) -> VehicleEvent:
    """The excursion by its `largest` values [m, deg], at the time it began."""
    beyond = [
        float(t_s[far[0]])
        for curve, limit in ((record.errors_m, DEGRADED_M), (record.errors_deg, DEGRADED_DEG))
        if curve is not None
        for t_s, value in [_within(curve, flown)]
        if len(far := np.flatnonzero(value > limit))
    ]
    text = f"off by {largest[0]:.1f} m and {largest[1]:.1f}°"
    return VehicleEvent(round(min([left_s, *beyond]), 3), DEGRADED, text)


def _find_touchdown(
    record: VehicleRecord,
    motion: VehicleMotion,
    flown: tuple[float, float],
    *,
    explained: bool,
) -> list[VehicleEvent]:
    """The touchdown, and whether it was uncommanded; failsafes and crashes are `explained`."""
    end_s = float(motion.t_s[-1])
    # The last heartbeat comes up to a second before the end of a log.
    disarmed = bool(record.armed) and record.armed[-1][1] < end_s - REST_S  # type: ignore[index]
    low = bool(motion.height_m[-1] <= AIRBORNE_M)
    rests = np.ptp(motion.height_m[motion.t_s > end_s - REST_S / 2.0]) < GROUND_M
    if not (disarmed or (low and rests)):
        return []
    t_s = round(flown[1], 3)
    commanded = record.commands is None or any(
        command.text in LANDING_MODES or command.text == "mission" for command in record.commands
    )
    mode = mode_at(record, t_s)
    piloted = mode in PILOT_MODES and is_within(t_s, record.lowered)
    # Autonomous landings at the end of a mission are what the mission commands.
    asked = commanded or piloted or mode in ("AUTO", "MISSION") or explained
    touchdown = VehicleEvent(t_s, "touchdown")
    return [touchdown] if asked else [touchdown, VehicleEvent(t_s, UNCOMMANDED, "not commanded")]


def describe_vehicle(found: VehicleOutcome) -> str:
    """Return the outcome in one line, with the chain of events in seconds."""
    shown = {found.outcome, FAILSAFE, LOST_CONTROL, FLEW_AWAY, CRASHED, "touchdown"}
    chain = ", ".join(
        f"{event.text if event.kind == found.outcome else event.kind} at {event.t_s:.1f} s"
        for event in found.events
        if event.kind in shown - {UNCOMMANDED}  # which is at the touchdown
    )
    return f"{found.outcome}; {chain}" if chain else found.outcome
