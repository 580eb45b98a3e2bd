"""Check of GPS and estimator before the first arming."""

from analysis.report.curves.recording import FlightData, Windows
from analysis.report.flight_checks import estimate_numbers
from analysis.report.flight_checks.level_checks import bench_checks
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck

BENCH_S = 2.0  # chosen: a problem must last until this long before arming


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Problems of GPS and estimator before the first arming give a warning, never a failure."""
    name = "before arming"
    # Too short for a check.
    if not armed or armed[0][0] < BENCH_S:
        return [FlightCheck(name, NONE, "the log does not cover it")]
    bench = [(0.0, armed[0][0])]
    found = [
        *bench_checks(recording, th, bench),
        *estimate_numbers.run_checks(recording, th, bench),
    ]
    last_s = armed[0][0] - BENCH_S  # earlier problems are ignored: a receiver takes time to start
    bad = [c for c in found if c.verdict in (WARN, FAIL) and any(e > last_s for _, e in c.windows)]
    if not bad:
        return [FlightCheck(name, PASS, "no problem that lasted until arming")]
    evidence = "; ".join(f"{check.name}: {check.evidence}" for check in bad)
    windows = tuple(window for check in bad for window in check.windows)
    return [FlightCheck(name, WARN, evidence, windows=windows)]
