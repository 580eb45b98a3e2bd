"""Tests of the user code: `pytest examples/pytest`, with only mavproxy-fault installed."""

import pytest
from preflight import objections


def test_a_healthy_vehicle_may_take_off(autopilot):
    assert objections(autopilot.url) == []


@pytest.mark.fault("constant", target="GPS_RAW_INT.fix_type", value=1)
def test_without_a_fix_it_stays_on_the_ground(autopilot):
    assert objections(autopilot.url) == ["there is no 3D fix"]


@pytest.mark.fault("constant", target="GPS_RAW_INT.satellites_visible", value=4)
def test_too_few_satellites_are_reported(autopilot):
    assert objections(autopilot.url) == ["4 satellites are too few"]


def test_a_fault_may_come_and_go(autopilot):
    with autopilot.proxy.fault("drop", target="GPS_RAW_INT"):
        assert objections(autopilot.url, silence_s=3.0) == ["the vehicle sends no GPS data"]
    autopilot.proxy.wait_for("GPS_RAW_INT.fix_type >= 3")
    assert objections(autopilot.url) == []
    assert [label.fault for label in autopilot.proxy.labels] == ["drop"]
