"""Checks of the autopilot's flags."""

import numpy as np
import pytest

from analysis.report.curves.recording import FlightData, Signal, Span
from analysis.report.flight_checks.autopilot_checks import run_checks
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import PASS, WARN


@pytest.mark.parametrize(
    ("speed_mps", "since_s", "verdict"), [(0.1, 0.1, PASS), (8.0, 0.1, WARN), (0.1, 4.0, WARN)]
)
def test_flags_of_a_starting_estimator_at_rest_are_ignored(
    speed_mps: float, since_s: float, verdict: str
) -> None:
    """A log of ten seconds without the arming state."""
    t_s = np.arange(0.0, 10.0, 0.2)
    found = FlightData("bench", "ardupilot", 0, 10.0)
    found.signals.append(Signal("speed", "GPS", t_s, np.full(len(t_s), speed_mps)))
    found.signals.append(Signal("ratio", "velocity", t_s, np.zeros(len(t_s))))
    found.spans.append(Span("estimator: position timeout", since_s, 10.0, "timeout", "flag"))
    flags = run_checks(found, Thresholds(), None)[0]
    assert (flags.name, flags.verdict) == ("flags of the autopilot", verdict)


@pytest.mark.parametrize(("until_s", "verdict"), [(5.4, PASS), (9.0, WARN), (30.0, WARN)])
def test_a_critical_status_that_ends_at_arming_is_none_of_the_flight(
    until_s: float, verdict: str
) -> None:
    found = FlightData("flight", "ardupilot", 0, 20.0)
    found.spans.append(Span("mode", 0.0, 20.0, "MANUAL", "mode"))
    found.spans.append(Span("system status", 0.1, until_s, "CRITICAL", "flag"))
    assert run_checks(found, Thresholds(), [(5.0, 20.0)])[-1].verdict == verdict


@pytest.mark.parametrize(("until_s", "verdict"), [(5.4, PASS), (9.0, WARN), (30.0, WARN)])
def test_a_flag_that_ends_at_arming_is_none_of_the_flight(until_s: float, verdict: str) -> None:
    found = FlightData("flight", "ardupilot", 0, 20.0)
    t_s = np.arange(0.0, 20.0, 0.2)
    found.signals.append(Signal("ratio", "velocity", t_s, np.zeros(len(t_s))))
    found.spans.append(Span("estimator: velocity timeout", 0.1, until_s, "timeout", "flag"))
    assert run_checks(found, Thresholds(), [(5.0, 20.0)])[0].verdict == verdict


@pytest.mark.parametrize(("text", "panel"), [("compass timeout", "mag"), ("GPS glitch", "gps-fix")])
def test_the_flag_of_a_sensor_that_is_not_fitted_is_ignored(text: str, panel: str) -> None:
    found = FlightData("flight", "ardupilot", 0, 20.0)
    t_s = np.arange(0.0, 20.0, 0.2)
    found.signals.append(Signal("ratio", "velocity", t_s, np.zeros(len(t_s))))
    found.spans.append(Span(f"estimator: {text}", 0.1, 20.0, text, "flag"))
    assert run_checks(found, Thresholds(), [(5.0, 20.0)])[0].verdict == PASS
    found.signals.append(Signal(panel, "first", t_s, np.full(len(t_s), 3.0)))
    assert run_checks(found, Thresholds(), [(5.0, 20.0)])[0].verdict == WARN
