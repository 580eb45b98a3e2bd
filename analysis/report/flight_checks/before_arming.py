"""What GPS and estimator showed on the bench."""

from analysis.report.flight_checks import estimate_checks, gps_checks
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck, Windows
from analysis.report.recordings.recording import FlightData

BENCH_S = 2.0  # before arming


def checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """One check over all of it."""
    return [_before_arming(recording, th, armed)]


def _before_arming(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """What the checks of GPS and estimator find before the first arming: a warning, no failure."""
    name = "before arming"
    # Too short to have shown anything.
    if not armed or armed[0][0] < BENCH_S:
        return FlightCheck(name=name, verdict=NONE, evidence="the log holds nothing of it")
    bench = [(0.0, armed[0][0])]
    found = [
        *gps_checks.checks(recording, th, bench),
        *estimate_checks.checks(recording, th, bench),
    ]
    last_s = armed[0][0] - BENCH_S  # only what lasts until then: a receiver takes time to start
    bad = [c for c in found if c.verdict in (WARN, FAIL) and any(e > last_s for _, e in c.windows)]
    if not bad:
        return FlightCheck(name=name, verdict=PASS, evidence="nothing that lasted until arming")
    evidence = "; ".join(f"{check.name}: {check.evidence}" for check in bad)
    windows = tuple(window for check in bad for window in check.windows)
    return FlightCheck(name=name, verdict=WARN, evidence=evidence, windows=windows)
