"""Checks of the GPS receiver: fix, satellites, dilution of precision, jumps, jamming."""

from analysis.report.curves.recording import FlightData, Signal, Windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import WARN, CheckLimits, FlightCheck, check_level

FIX_2D = 2


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each quantity of the receiver."""
    of, hold = recording.of, th.hold_s
    used = of("gps-satellites") if _has_fix(recording) else []
    satellites = CheckLimits(*th.gps_satellites, below=True, hold_s=hold)
    dilution = CheckLimits(*th.gps_dilution, hold_s=hold)
    jamming = CheckLimits(*th.gps_jamming, hold_s=hold)
    return [
        _fix(recording, th, armed),
        check_level("GPS satellites", used, satellites, armed),
        check_level("GPS dilution of precision", of("gps-dilution"), dilution, armed),
        check_level("GPS jumps", of("gps-jump"), CheckLimits(*th.gps_step_m, "m"), armed),
        # Jamming is checked on the ground too.
        check_level("GPS jamming indicator", _jamming(recording), jamming, None),
    ]


def _has_fix(recording: FlightData) -> bool:
    # `_fix` judges a receiver without any fix.
    return any(signal.value.max(initial=0) >= FIX_2D for signal in recording.of("gps-fix"))


def _fix(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Check the fix type; a receiver without any fix is a warning only, as it may be unused."""
    fixes = recording.of("gps-fix")
    limits = CheckLimits(*th.gps_fix_type, below=True, hold_s=th.hold_s)
    if not fixes or _has_fix(recording):
        return check_level("GPS fix", fixes, limits, armed)
    evidence = "the receiver sends messages but has no fix in the entire log"
    return FlightCheck(
        name="GPS fix", verdict=WARN, evidence=evidence, limit=limits.text(), panel="gps-fix"
    )


def _jamming(recording: FlightData) -> list[Signal]:
    return [s for s in recording.of("gps-noise") if s.name.startswith("jamming indicator")]
