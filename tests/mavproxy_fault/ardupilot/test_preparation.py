import pytest

from mavproxy_fault.ardupilot.hil_readings import TrueState
from mavproxy_fault.ardupilot.preparation import REPEAT_US, Preparation, stream_requests
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser

EAST = TrueState(0, (0.5**0.5, 0.0, 0.0, 0.5**0.5), 474_000_000, 85_000_000, 0, (0.0, 0.0, 0.0))


def frame(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def parse_request(raw):
    (found,) = Parser().push(raw)
    assert isinstance(found, Frame)
    return found


def test_the_replies_of_a_real_autopilot_complete_it(mavlink_bytes):
    preparation, t_us, requests = Preparation(EAST), 0, []
    for item in Parser().push(mavlink_bytes):
        t_us += 2 * REPEAT_US
        if (raw := preparation.due(t_us)) is not None:
            requests.append(parse_request(raw).layout.name)
        preparation.received(item)
    assert preparation.pending == ""
    assert preparation.due(10**12) is None
    assert requests[0] == "PARAM_REQUEST_READ"
    assert requests[-1] == "COMMAND_LONG"


def test_the_streams_for_conditions_and_reports_are_requested_from_a_board():
    """A board streams nothing by itself: `from: take-off` would never occur."""
    preparation, numbers = Preparation(EAST, stream_requests()), []
    while preparation.pending.startswith("stream"):
        numbers.append(parse_request(preparation.due(0)).number("param1"))
        preparation.received(frame("COMMAND_ACK", command=511))
    assert numbers == [36, 33, 30, 193]  # outputs first: they drive the motors


def test_a_request_is_repeated_each_second_until_it_is_answered():
    preparation = Preparation(EAST)
    assert preparation.due(0) is not None
    assert preparation.due(REPEAT_US - 1) is None
    assert preparation.due(REPEAT_US) is not None


def test_an_autopilot_on_another_estimator_is_refused():
    with pytest.raises(ConfigError, match="AHRS_EKF_TYPE: ArduPilot has 10"):
        Preparation(EAST).received(
            frame("PARAM_VALUE", param_id=b"AHRS_EKF_TYPE", param_value=10.0)
        )


def test_a_rejected_calibration_is_repeated_and_that_of_the_compass_has_the_heading():
    preparation = Preparation(EAST)
    for name, value in ((b"AHRS_EKF_TYPE", 3.0), (b"EAHRS_TYPE", 1.0)):
        preparation.received(frame("PARAM_VALUE", param_id=name, param_value=value))
    preparation.received(frame("COMMAND_ACK", command=241, result=1))
    assert preparation.pending == "accelerometer calibration"
    preparation.received(frame("COMMAND_ACK", command=241, result=0))
    command = parse_request(preparation.due(0))
    assert command.number("command") == 42006
    assert command.number("param1") == pytest.approx(90.0)
    assert command.number("param3") == pytest.approx(47.4, abs=1e-5)
