import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.vehicles.actuators import motor_mix, plane_mix, read_controls


def answer(channels: dict[int, float], mode: int = 129, t_us: int = 1_132_000) -> Frame:
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    values = [channels.get(i, 0.0) for i in range(16)]
    raw = mav.hil_actuator_controls_encode(t_us, values, mode, 1).pack(mav)
    return Frame(raw, message_layout("HIL_ACTUATOR_CONTROLS"))


def test_motors_are_in_px4s_order_with_the_timestamp_they_answer() -> None:
    stamp_us, controls = read_controls(answer({0: 0.1, 1: 0.2, 2: 0.3, 3: 0.4}), motor_mix(4))
    assert stamp_us == 1_132_000
    assert controls.armed
    assert controls.values.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_the_mode_field_reports_a_disarmed_autopilot() -> None:
    _, controls = read_controls(answer({}, mode=1), motor_mix(4))
    assert not controls.armed


def test_surfaces_have_the_signs_of_the_model() -> None:
    _, controls = read_controls(answer({2: 0.3, 4: 0.6, 5: -0.2, 6: 0.4, 7: 0.5}), plane_mix)
    elevator, aileron, rudder, throttle = controls.values.tolist()
    assert elevator == pytest.approx(-0.5)  # trailing edge up is negative
    assert aileron == pytest.approx(0.3)  # right up, left down: rolls right
    assert rudder == pytest.approx(-0.3)  # trailing edge right is negative
    assert throttle == pytest.approx(0.6)


def test_commands_outside_their_range_are_limited_and_nan_is_off() -> None:
    _, controls = read_controls(answer({0: math.nan, 1: -1.0, 2: 2.0, 3: 0.5}), motor_mix(4))
    assert controls.values.tolist() == pytest.approx([0.0, 0.0, 1.0, 0.5])
    _, controls = read_controls(answer({4: -1.0, 7: -3.0}), plane_mix)
    assert controls.values.tolist() == pytest.approx([1.0, 0.0, 0.0, 0.0])
