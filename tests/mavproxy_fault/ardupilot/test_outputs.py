import pytest

from mavproxy_fault.ardupilot.feeding.json_physics import read_servos
from mavproxy_fault.ardupilot.outputs import actuator_frame, motor_channels, plane_channels
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser


def test_motors_run_from_nothing_to_full():
    assert motor_channels([1000, 1500, 2000, 2100] + [0] * 12)[:5] == [0.0, 0.5, 1.0, 1.0, 0.0]


def test_the_motors_of_a_real_copter_are_off_before_arming(servo_packets):
    first = read_servos(servo_packets[0])
    assert motor_channels(first.pwm_us)[:4] == [0.0] * 4
    lift_off = read_servos(servo_packets[-1])
    assert min(motor_channels(lift_off.pwm_us)[:4]) > 0.6


@pytest.mark.parametrize(
    ("pwm_us", "channels"),
    [
        ((2000, 1500, 1000, 1500), {5: -1.0, 6: 1.0}),  # roll to the right
        ((1500, 2000, 1000, 1500), {7: 1.0}),  # nose up
        ((1500, 1500, 1000, 2000), {2: 1.0}),  # nose right
        ((1500, 1500, 1750, 1500), {4: 0.75}),
        ((0, 0, 0, 0), {}),  # no output yet
    ],
)
def test_a_planes_outputs_reach_the_channels_of_px4(pwm_us, channels):
    found = plane_channels([*pwm_us, *[0] * 12])
    assert {number: value for number, value in enumerate(found) if value} == channels


def test_the_answer_has_the_timestamp_of_its_step_and_the_armed_flag():
    raw = actuator_frame(2_500, [0.25] * 16, 7, armed=True)
    (frame,) = Parser().push(raw)
    assert isinstance(frame, Frame)
    assert frame.number("time_usec") == 2_500
    assert frame.number("flags") == 1
    assert frame.number("mode") == 129
    assert [frame.number("controls", n) for n in range(16)] == [0.25] * 16
