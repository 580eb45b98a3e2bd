import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.ardupilot.feeding.optical_flow import SCALER, FlowInput
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser

PERIOD_US = 50_000


def flow(rate_rps, **values):
    """A camera's frame for one period at a rate about x, and twice that about -y."""
    layout = message_layout("HIL_OPTICAL_FLOW")
    angle = rate_rps * PERIOD_US * 1e-6
    fields = {"integrated_x": angle, "integrated_y": -2 * angle, "quality": 255, "distance": 9.5}
    return Frame(
        build_frame(layout, {"integration_time_us": PERIOD_US, **fields, **values}), layout
    )


def sent(raw):
    (found,) = Parser().push(raw)
    assert isinstance(found, Frame)
    return found


def rate_of_the_driver(found, since_us):
    """flowRate.x as AP_OpticalFlow_MAV::update computes it from one frame."""
    return found.number("flow_x") * (1.0 + 0.001 * SCALER) * since_us * 1e-6


@given(rate_rps=st.floats(-8, 8), since_us=st.integers(5_000, 490_000))
def test_the_driver_finds_the_rate_whatever_the_time_between_two_frames(rate_rps, since_us):
    one = FlowInput()
    one.step(flow(0.0), 1_000)
    found = sent(one.step(flow(rate_rps), 1_000 + since_us))
    step_rps = 0.01 * since_us * 1e-6  # of one count
    most_rps = 0x7FFF * step_rps
    expected = min(max(rate_rps, -most_rps), most_rps)
    assert rate_of_the_driver(found, since_us) == pytest.approx(expected, abs=0.51 * step_rps)


def test_quality_and_distance_are_the_cameras():
    found = sent(FlowInput().step(flow(0.1), 0))
    assert (found.number("quality"), found.number("ground_distance")) == (255, 9.5)


def test_a_frame_that_a_fault_dropped_does_not_double_the_next_ones_rate():
    one = FlowInput()
    for t_us in (0, PERIOD_US):
        one.step(flow(0.4), t_us)
    found = sent(one.step(flow(0.4), 3 * PERIOD_US))
    assert rate_of_the_driver(found, 2 * PERIOD_US) == pytest.approx(0.4, abs=0.001)


def test_two_frames_at_once_are_one():
    one = FlowInput()
    assert one.step(flow(0.4), 5_000) is not None
    assert one.step(flow(0.4), 5_000) is None


@pytest.mark.parametrize("broken", [{"integrated_x": math.nan}, {"integration_time_us": 0}])
def test_an_invalid_number_is_no_flow(broken):
    assert sent(FlowInput().step(flow(0.4, **broken), 0)).number("flow_x") == 0
