"""What a receiver says of itself: fix, satellites, dilution, jumps, jamming."""

from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import WARN, Check, Limits, Windows, level
from analysis.report.recordings.recording import Recording, Signal

FIX_2D = 2


def checks(recording: Recording, th: Thresholds, armed: Windows | None) -> list[Check]:
    """One check a quantity."""
    of, hold = recording.of, th.hold_s
    used = of("gps-satellites") if _has_fix(recording) else []
    satellites = Limits(*th.gps_satellites, below=True, hold_s=hold)
    dilution = Limits(*th.gps_dilution, hold_s=hold)
    jamming = Limits(*th.gps_jamming, hold_s=hold)
    return [
        _fix(recording, th, armed),
        level("GPS satellites", used, satellites, armed),
        level("GPS dilution of precision", of("gps-dilution"), dilution, armed),
        level("GPS jumps", of("gps-jump"), Limits(*th.gps_step_m, "m"), armed),
        # Jamming matters on the ground too.
        level("GPS jamming indicator", _jamming(recording), jamming, None),
    ]


def _has_fix(recording: Recording) -> bool:
    # A receiver that never had any fix is judged by `_fix`.
    return any(signal.value.max(initial=0) >= FIX_2D for signal in recording.of("gps-fix"))


def _fix(recording: Recording, th: Thresholds, armed: Windows | None) -> Check:
    """A receiver without any fix may be one nobody relies on: that is a warning, no failure."""
    fixes = recording.of("gps-fix")
    limits = Limits(*th.gps_fix_type, below=True, hold_s=th.hold_s)
    if not fixes or _has_fix(recording):
        return level("GPS fix", fixes, limits, armed)
    evidence = "the receiver reports, but has no fix in the whole log"
    return Check(
        name="GPS fix", verdict=WARN, evidence=evidence, limit=limits.text(), panel="gps-fix"
    )


def _jamming(recording: Recording) -> list[Signal]:
    return [s for s in recording.of("gps-noise") if s.name.startswith("jamming indicator")]
