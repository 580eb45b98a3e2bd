"""The outcome of a fault: its label compared with the monitor's alarms. See docs/verdicts.md.

A fault is evaluated from its first frame to one GNSS epoch after its last (a receiver's: to its
last). Isolations in that time count as correct or wrong; afterwards, within the recovery time, it
may still be detected late. Everything is computed from labels and results, never from the schedule.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import msgspec

from analysis.results import FOREVER_US, OR_SEPARATOR
from analysis.scoring.alarm_windows import AlarmWindow, subtract_intervals
from analysis.scoring.fault_channels import (
    HARMLESS_FAULTS,
    RECEIVER_NAMES,
    FaultVisibility,
    fault_visibility,
)
from mavproxy_fault.wire.label import Label

RECOVERY_S = 10.0  # alarms up to this long after a fault are its aftermath: until readmission

ISOLATED, WRONG, AMBIGUOUS, DETECTED = "isolated", "wrong", "ambiguous", "detected"
LATE, MISSED, NOT_JUDGED = "late", "missed", "not judged"


class WrongIsolation(msgspec.Struct, frozen=True, kw_only=True):
    """An isolated healthy sensor: start on the schedule's time axis and duration, in seconds."""

    who: str
    from_s: float
    for_s: float


class FaultOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """One injected fault and its detection; times in seconds from the start of the schedule.

    `channels` can observe it. `verdict` is one of the constants above, `reason` gives the details.
    `isolated` are correct isolations, `wrongly` those of healthy sensors.
    """

    id: str
    fault: str
    preset: str | None
    target: str
    start_s: float
    end_s: float | None
    frames: int
    channels: tuple[str, ...]
    detected: bool
    delay_s: float | None
    isolated: tuple[str, ...]
    wrongly: tuple[WrongIsolation, ...]
    verdict: str
    reason: str


class _FaultPeriod(NamedTuple):
    """A label with its visibility, the end of its evaluation and of its aftermath."""

    label: Label
    visibility: FaultVisibility
    until_us: int
    aftermath_us: int
    witnesses: frozenset[str]

    def explains(self, window: AlarmWindow) -> bool:
        """Whether this fault can have caused the alarms of a window."""
        # Without a name only the channel counts.
        if not window.name:
            return window.channel in self.visibility.channels | self.witnesses
        return any(map(self.visibility.allows, window.name.split(OR_SEPARATOR)))


def fault_outcomes(
    labels: Sequence[Label],
    windows: Sequence[AlarmWindow],
    active: Collection[str],
    epoch_us: int,
    witnesses: frozenset[str] = frozenset(),
) -> list[FaultOutcome]:
    """One row per label, in order.

    Parameters
    ----------
    labels : sequence of Label
        The injected faults.
    windows : sequence of Window
        The monitor's alarms.
    active : collection of str
        The channels with at least one test result in this flight.
    epoch_us : int
        Time between two epochs of the detector.
    witnesses : frozenset of str
        Channels that may react to any fault, such as an autopilot.
    """
    periods = [_fault_period(label, epoch_us, witnesses) for label in labels]
    return [_outcome(period, periods, windows, active) for period in periods]


def _fault_period(
    label: Label, epoch_us: int, witnesses: frozenset[str] = frozenset()
) -> _FaultPeriod:
    # A fault still acting at the end of the log.
    end_us = FOREVER_US if label.end_us is None else label.end_us
    # An excluded sensor looks healthy from the first epoch on and is readmitted later.
    aftermath_us = end_us + epoch_us + round(RECOVERY_S * 1e6)
    visibility = fault_visibility(label)
    # The first good fix after a receiver's fault only shows the jump back.
    of_receiver = any(names >= RECEIVER_NAMES for names in visibility.must_isolate)
    until_us = end_us if of_receiver else end_us + epoch_us
    if label.fault in HARMLESS_FAULTS:
        witnesses = frozenset()
    return _FaultPeriod(label, visibility, until_us, aftermath_us, witnesses)


def _outcome(
    period: _FaultPeriod,
    periods: Sequence[_FaultPeriod],
    windows: Sequence[AlarmWindow],
    active: Collection[str],
) -> FaultOutcome:
    label = period.label
    # Alarms before the fault cannot be caused by it.
    began = [w for w in windows if label.start_us <= w.start_us <= period.until_us]
    own = [w for w in began if period.explains(w)]
    # What no channel can observe is not detected, even if an isolation is its consequence.
    seen = own if period.visibility.channels | period.witnesses else []
    right = tuple(sorted({w.name for w in own if w.isolated}))
    wrongly = [w for w in began if w.isolated and not _explained(w, periods)]
    verdict, reason = _verdict(period, own, right, active)
    if verdict == MISSED:
        verdict, reason = _late_verdict(period, periods, windows)
    # Isolating a healthy sensor is worse than missing the fault: it overrides any verdict.
    if wrongly:
        verdict, reason = WRONG, f"otherwise {reason or verdict}"
    return FaultOutcome(
        id=label.id,
        fault=label.fault,
        preset=label.preset,
        target=f"{label.fault} by the {label.by}" if label.by else label.describe_target(),
        start_s=_seconds(label, label.start_us),
        end_s=None if label.end_us is None else _seconds(label, label.end_us),
        frames=label.frames,
        channels=tuple(sorted(period.visibility.channels)),
        detected=bool(seen),
        # From the fault's start to its first window.
        delay_s=_seconds(label, seen[0].start_us - label.start_us + label.t0_us) if seen else None,
        isolated=right,
        wrongly=tuple(_wrong_isolation(label, w) for w in wrongly),
        verdict=verdict,
        reason=reason,
    )


def _verdict(
    period: _FaultPeriod, own: Sequence[AlarmWindow], right: Sequence[str], active: Collection[str]
) -> tuple[str, str]:
    """Verdict and reason of a fault, regardless of wrongly isolated sensors."""
    visibility = period.visibility
    observing = visibility.channels | period.witnesses
    # No channel can observe this fault: no verdict about the monitor.
    if not observing:
        return NOT_JUDGED, visibility.reason
    if not own and not observing & set(active):
        return NOT_JUDGED, f"no {' or '.join(sorted(observing))} in this flight"
    if not own:
        return MISSED, ""
    missing = [
        c
        for c in visibility.must_isolate
        if not any(FaultVisibility(c, (), c).allows(n) for n in right)
    ]
    if right and not missing:
        return ISOLATED if visibility.must_isolate else DETECTED, ""
    # The detector reported an ambiguous pair: less than isolated, more than an alarm.
    either = sorted({w.name for w in own if OR_SEPARATOR in w.name})
    if either:
        return AMBIGUOUS, ", ".join(either)
    if right:
        return DETECTED, f"not isolated: {', '.join(' or '.join(sorted(c)) for c in missing)}"
    return DETECTED, "nothing was isolated"


def _late_verdict(
    period: _FaultPeriod, periods: Sequence[_FaultPeriod], windows: Sequence[AlarmWindow]
) -> tuple[str, str]:
    """Verdict of a fault not detected while it acted: earlier alarm, late, or missed."""
    label, others = period.label, [w for w in periods if w is not period]
    for window in windows:
        if not period.explains(window):
            continue
        # An earlier alarm that lasts into the fault cannot be distinguished from it.
        if window.start_us < label.start_us <= window.end_us:
            return NOT_JUDGED, f"{window.name or window.channel} had an alarm before the fault"
        late = period.until_us < window.start_us <= period.aftermath_us
        # The aftermath of another fault is no late detection.
        if late and not any(other.explains(window) and _covers(other, window) for other in others):
            after_s = (window.start_us - (label.end_us or 0)) * 1e-6
            return LATE, f"detected {after_s:.1f} s after its end"
    return MISSED, ""


def _covers(period: _FaultPeriod, window: AlarmWindow) -> bool:
    return period.label.start_us <= window.start_us <= period.aftermath_us


def _explained(window: AlarmWindow, periods: Sequence[_FaultPeriod]) -> bool:
    return any(period.explains(window) and _covers(period, window) for period in periods)


def _seconds(label: Label, t_us: int) -> float:
    return round((t_us - label.t0_us) * 1e-6, 3)


def _wrong_isolation(label: Label, window: AlarmWindow) -> WrongIsolation:
    return WrongIsolation(
        who=window.name,
        from_s=_seconds(label, window.start_us),
        for_s=round((window.end_us - window.start_us) * 1e-6, 3),
    )


class FalseAlarms(msgspec.Struct, frozen=True, kw_only=True):
    """False alarms of a channel.

    `outside` and `inside` count alarm windows outside and inside of faults (with their aftermath);
    inside, alarms without an exclusion do not count. `blamed` were excluded wrongly, for `seconds`
    in total; `per_hour` is the rate of windows.
    """

    channel: str
    outside: int
    inside: int
    blamed: tuple[str, ...]
    seconds: float
    per_hour: float


def false_alarms(
    labels: Sequence[Label], windows: Sequence[AlarmWindow], span_s: float, epoch_us: int
) -> list[FalseAlarms]:
    """By channel the alarms that no fault explains, whether or not another fault acted."""
    periods = [_fault_period(label, epoch_us) for label in labels]
    acting = [(period.label.start_us, period.aftermath_us) for period in periods]
    rows: dict[str, list[tuple[AlarmWindow, bool, float]]] = {}
    for window in windows:
        explained = [
            at for at, period in zip(acting, periods, strict=True) if period.explains(window)
        ]
        for start_us, end_us in subtract_intervals(window, explained):
            inside = any(start <= start_us <= end for start, end in acting)
            # An alarm without an exclusion during another fault does no harm.
            if window.isolated or not inside:
                row = window, inside, (end_us - start_us) * 1e-6
                rows.setdefault(window.channel, []).append(row)
    return [_false_row(channel, alarms, span_s) for channel, alarms in sorted(rows.items())]


def _false_row(
    channel: str, alarms: Sequence[tuple[AlarmWindow, bool, float]], span_s: float
) -> FalseAlarms:
    inside = sum(within for _, within, _ in alarms)
    return FalseAlarms(
        channel=channel,
        outside=len(alarms) - inside,
        inside=inside,
        blamed=tuple(sorted({window.name for window, _, _ in alarms if window.isolated})),
        seconds=round(sum(seconds for window, _, seconds in alarms if window.isolated), 3),
        # Windows, not epochs: a long false alarm counts once.
        per_hour=round(3600.0 * len(alarms) / span_s, 2) if span_s > 0 else 0.0,
    )
