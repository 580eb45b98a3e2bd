"""Check of GPS and estimator before the first arming."""

from analysis.report.curves.recording import FlightData, Windows
from analysis.report.flight_checks import estimate_checks, gps_checks
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck

BENCH_S = 2.0  # chosen: a problem must last until this long before arming


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check GPS and estimator before arming."""
    return [_before_arming(recording, th, armed)]


def _before_arming(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Problems of GPS and estimator before the first arming give a warning, never a failure."""
    name = "before arming"
    # Too short for a check.
    if not armed or armed[0][0] < BENCH_S:
        return FlightCheck(name=name, verdict=NONE, evidence="the log does not cover it")
    bench = [(0.0, armed[0][0])]
    found = [
        *gps_checks.run_checks(recording, th, bench),
        *estimate_checks.run_checks(recording, th, bench),
    ]
    last_s = armed[0][0] - BENCH_S  # earlier problems are ignored: a receiver takes time to start
    bad = [c for c in found if c.verdict in (WARN, FAIL) and any(e > last_s for _, e in c.windows)]
    if not bad:
        return FlightCheck(name=name, verdict=PASS, evidence="no problem that lasted until arming")
    evidence = "; ".join(f"{check.name}: {check.evidence}" for check in bad)
    windows = tuple(window for check in bad for window in check.windows)
    return FlightCheck(name=name, verdict=WARN, evidence=evidence, windows=windows)
