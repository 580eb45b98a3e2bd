"""The estimator and IMU in use are judged, the others beside them."""

import numpy as np
import pytest

from analysis.report.curves.recording import FlightData, LinkQuality, Message, Signal, Span
from analysis.report.flight_checks import flight_checks
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FlightCheck
from analysis.report.judging.lanes_in_use import imu_windows

T_S = np.arange(0.0, 60.0, 0.1)
ARMED = Span("armed", 0.0, 60.0, "armed", "mode")


def checks(recording: FlightData) -> dict[str, FlightCheck]:
    return {check.name: check for check in flight_checks(recording, Thresholds())}


def two_cores(second: float, switched_s: float | None = None) -> FlightData:
    """Two estimators, of which the second has a variance of `second`; it may be switched to."""
    signals = [
        Signal("variance", "velocity", T_S, np.full_like(T_S, 0.1)),
        Signal("variance", "velocity 2", T_S, np.full_like(T_S, second)),
        Signal("vibration", "x", T_S, np.full_like(T_S, 5.0)),
        Signal("vibration", "x 2", T_S, np.full_like(T_S, 100.0 * second)),
    ]
    spans = [ARMED]
    if switched_s is not None:
        spans += [
            Span("estimator in use", 0.0, switched_s, "core 1", "mode"),
            Span("estimator in use", switched_s, 60.0, "core 2", "mode"),
        ]
    return FlightData("x", "ardupilot", duration_s=60.0, signals=signals, spans=spans)


@pytest.mark.parametrize("name", ["EKF variances", "vibration"])
def test_what_is_not_in_use_stands_beside_the_verdict(name: str) -> None:
    found = checks(two_cores(0.9))[name]
    assert found.verdict == "PASS"
    assert "not in use" in found.evidence


@pytest.mark.parametrize("name", ["EKF variances", "vibration"])
def test_what_is_in_use_is_judged_from_then_on(name: str) -> None:
    found = checks(two_cores(0.9, switched_s=40.0))[name]
    assert found.verdict == "FAIL"
    assert found.windows[0][0] == pytest.approx(40.0, abs=0.2)


def test_the_imu_of_a_core_follows_from_the_mask_or_from_the_device() -> None:
    first = FlightData("x", parameters={"EK3_IMU_MASK": [(0.0, 6.0)]})
    assert list(imu_windows(first)) == [2]
    messages = {
        name: Message(T_S[:1], {"accel_device_id": np.array([device])})
        for name, device in (
            ("estimator_status", 30), ("vehicle_imu_status", 10), ("vehicle_imu_status_2", 30),
        )
    }  # fmt: skip
    assert list(imu_windows(FlightData("x", messages=messages))) == [2]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_damaged_parameter_is_left_out(value: float) -> None:
    found = FlightData("x")
    found.add_parameter("EK3_IMU_MASK", 0.0, value)
    assert list(imu_windows(found)) == list(imu_windows(FlightData("x")))


def test_a_companions_link_judges_no_flight_of_an_autopilot() -> None:
    good, bad = LinkQuality("", 1, 1, 5000, 0, 0.1), LinkQuality("", 1, 191, 5000, 2000, 30.0)
    found = checks(FlightData("x", systems=(1,), links=[good, bad]))
    assert found["link from 1/1"].verdict == "PASS"
    assert "link from 1/191" not in found
    assert checks(FlightData("x", systems=(1,), links=[bad]))["link from 1/191"].verdict == "FAIL"
