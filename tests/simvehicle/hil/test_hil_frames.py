import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.rtcm.msm7 import decode_msm7
from mavproxy_fault.rtcm.transport import Reassembler, message_number, tunnel_payload, wrap_message
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.hil import frame_kernel
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.sensors.compiled_sensor import BARO, IMU, MAG, PITOT
from simvehicle.sensors.flight_record import FLIGHT, SENSOR, Board
from simvehicle.sensors.readings import (
    BatteryReading,
    EphemerisReading,
    FlowReading,
    GpsReading,
    PseudorangeReading,
    RangeReading,
    RemoteControlReading,
    VisionReading,
)

SENSORS = (
    (IMU, 0, [1.0, 2.0, -9.8, 0.1, 0.2, 0.3]),
    (IMU, 1, [1.0, 2.0, -9.8, 0.1, 0.2, 0.3]),
    (IMU, 2, [1.0, 2.0, -9.8, 0.1, 0.2, 0.3]),
    (MAG, 0, [0.2, 0.01, 0.43]),
    (BARO, 0, [95600.0, 488.0, 25.0]),
    (PITOT, 0, [60.0]),
)
ALL = (0, 3, 4, 5)  # the first of each kind
HERE = {"latitude": 0, "density": 5, "velocity": 6, "attitude": 9, "air": 13}


class Link:
    """A packer on a board of its own, over Zurich, at rest."""

    def __init__(self, **here: list[float]) -> None:
        self.board = Board(np.zeros(1, dtype=FLIGHT), np.zeros(len(SENSORS), dtype=SENSOR))
        for record, (kind, number, values) in zip(self.board.sensors, SENSORS, strict=True):
            record["kind"], record["id"] = kind, number
            record["values"][: len(values)] = values
        flight = self.board.flight[0]
        flight["load"][:3] = 0.0, 0.0, -9.80665
        place = [math.radians(47.397742), math.radians(8.545594), 535.0]
        at_rest = {"latitude": place, "density": [1.225], "attitude": [1.0]}
        flight["home"][12] = 47.0  # the geoid
        for name, values in (at_rest | here).items():
            flight["here"][HERE[name] : HERE[name] + len(values)] = values
        self.packer = HilPacker(self.board)

    def frames(self, t_us: int, readings: list, fresh: tuple[int, ...] = ()) -> list[bytes]:
        self.board.flight["t_us"] = t_us
        self.board.sensors["fresh"] = [number in fresh for number in range(len(SENSORS))]
        return self.packer.frames(readings)


def decode(frames: list[bytes]) -> list[dialect.MAVLink_message]:
    return dialect.MAVLink(None).parse_buffer(b"".join(frames)) or []


def one(frames: list[bytes], name: str) -> dialect.MAVLink_message:
    (match,) = [m for m in decode(frames) if m.get_type() == name]
    return match


def test_a_full_step_sets_every_bit_of_each_group_in_one_message() -> None:
    sensor = one(Link().frames(0, [], ALL), "HIL_SENSOR")
    assert sensor.fields_updated == 0x1FFF
    assert sensor.time_usec == 1_000_000
    assert (sensor.get_srcSystem(), sensor.get_srcComponent()) == (1, 51)
    assert [sensor.xacc, sensor.yacc, sensor.zacc] == pytest.approx([1.0, 2.0, -9.8])
    assert [sensor.xgyro, sensor.ygyro, sensor.zgyro] == pytest.approx([0.1, 0.2, 0.3])
    assert [sensor.xmag, sensor.ymag, sensor.zmag] == pytest.approx([0.2, 0.01, 0.43])
    assert sensor.abs_pressure == pytest.approx(956.0)
    assert sensor.pressure_alt == pytest.approx(488.0)
    assert sensor.temperature == pytest.approx(25.0)
    assert sensor.diff_pressure == pytest.approx(0.6)


@pytest.mark.parametrize(("number", "bits"), [(0, 0x3F), (3, 0x1C0), (4, 0x1A00), (5, 0x400)])
def test_each_reading_marks_its_own_group_only(number: int, bits: int) -> None:
    assert one(Link().frames(0, [], (number,)), "HIL_SENSOR").fields_updated == bits


def test_values_without_a_new_reading_keep_the_last_one() -> None:
    link = Link()
    link.frames(0, [], (0, 4))
    sensor = one(link.frames(4000, [], (0,)), "HIL_SENSOR")
    assert sensor.fields_updated == 0x3F
    assert sensor.abs_pressure == pytest.approx(956.0)


def test_several_imus_have_separate_messages_after_that_of_id_0() -> None:
    frames = Link().frames(0, [], (2, 0, 1))
    assert [m.id for m in decode(frames) if m.get_type() == "HIL_SENSOR"] == [0, 1, 2]


def test_gps_scales_to_wire_units_and_centimetres_of_error() -> None:
    reading = GpsReading(
        0, -33.8688197, 151.2092955, 58.25, np.array([3.0, -4.0, 0.5]), 3, 11, 0.9, 1.5
    )
    gps = one(Link().frames(0, [reading]), "HIL_GPS")
    assert (gps.lat, gps.lon, gps.alt) == (-338688197, 1512092955, 58250)
    assert (gps.vel, gps.vn, gps.ve, gps.vd) == (500, 300, -400, 50)
    assert gps.cog == round((math.degrees(math.atan2(-4, 3)) % 360) * 100)
    assert (gps.eph, gps.epv, gps.fix_type, gps.satellites_visible) == (90, 150, 3, 11)


def test_course_is_unknown_at_rest() -> None:
    reading = GpsReading(0, 1.0, 2.0, 3.0, np.array([0.1, 0.1, 0.0]), 3, 11, 0.9, 1.5)
    assert one(Link().frames(0, [reading]), "HIL_GPS").cog == 65535


def test_a_delayed_reading_keeps_the_timestamp_of_its_measurement() -> None:
    reading = GpsReading(100_000, 1.0, 2.0, 3.0, np.zeros(3), 3, 11, 0.9, 1.5)
    frames = Link().frames(220_000, [reading], (0,))
    assert one(frames, "HIL_GPS").time_usec == 1_100_000
    assert one(frames, "HIL_SENSOR").time_usec == 1_220_000


def test_truth_is_sent_with_attitude_velocity_and_airspeed() -> None:
    q = [math.cos(0.1), 0.0, math.sin(0.1), 0.0]
    link = Link(attitude=q, velocity=[1.5, -2.5, 0.25], air=[3.0, 4.0, 0.0], density=[1.225 / 4])
    link.board.flight["x"][0, 10:13] = 0.01, 0.02, 0.03
    state = one(link.frames(8000, []), "HIL_STATE_QUATERNION")
    assert state.time_usec == 1_008_000
    assert state.attitude_quaternion == pytest.approx(q, abs=1e-7)
    assert (state.vx, state.vy, state.vz) == (150, -250, 25)
    assert (state.lat, state.lon, state.alt) == (473977420, 85455940, 488000)
    assert (state.true_airspeed, state.ind_airspeed, state.zacc) == (500, 250, -1000)


def test_range_flow_vision_and_battery_have_their_messages() -> None:
    turned = np.array([math.sqrt(0.5), 0, 0, math.sqrt(0.5)])  # heading east
    readings = [
        RangeReading(0, 12.34, 0.2, 40.0),
        FlowReading(0, 0.02, np.array([0.01, -0.02]), np.array([0.1, 0.2, 0.3]), 12.3, 200),
        VisionReading(0, np.array([1.0, 2, -3]), np.array([0.0, 5, 0]), turned, 0.1, 0.2),
        BatteryReading(0, 15.8, 12.34, 0.876),
        RemoteControlReading(0, (1500, 1600, 1000, 1500)),
    ]
    frames = Link().frames(0, readings)
    distance = one(frames, "DISTANCE_SENSOR")
    assert (distance.min_distance, distance.current_distance, distance.max_distance) == (
        20,
        1234,
        4000,
    )
    assert distance.orientation == dialect.MAV_SENSOR_ROTATION_PITCH_270
    flow = one(frames, "HIL_OPTICAL_FLOW")
    assert flow.integration_time_us == 20_000
    assert flow.integrated_y == pytest.approx(-0.02)
    assert flow.quality == 200
    pose = one(frames, "ODOMETRY")
    assert (pose.frame_id, pose.child_frame_id) == (1, 12)
    assert [pose.vx, pose.vy, pose.vz] == pytest.approx([5.0, 0.0, 0.0], abs=1e-6)
    assert [pose.pose_covariance[i] for i in (0, 6, 11)] == pytest.approx([0.01] * 3)
    assert all(math.isnan(pose.pose_covariance[i]) for i in (15, 18, 20))
    battery = one(frames, "BATTERY_STATUS")
    assert (battery.voltages[0], battery.voltages[1]) == (15800, 65535)
    assert (battery.current_battery, battery.battery_remaining) == (1234, 88)
    sticks = one(frames, "RC_CHANNELS")
    assert (sticks.chancount, sticks.chan2_raw, sticks.chan5_raw) == (4, 1600, 0)


def test_vision_may_be_sent_as_a_pose_only() -> None:
    half = math.radians(30.0) / 2
    leaning = np.array([math.cos(half), math.sin(half), 0, 0])
    reading = VisionReading(
        40_000, np.array([1.0, 2, -3]), np.array([0.0, 5, 0]), leaning, 0.1, 0.2, odometry=False
    )
    frames = Link().frames(40_000, [reading])
    pose = one(frames, "VISION_POSITION_ESTIMATE")
    assert (pose.usec, pose.x, pose.y, pose.z) == (1_040_000, 1.0, 2.0, -3.0)
    assert [pose.roll, pose.pitch, pose.yaw] == pytest.approx([math.radians(30.0), 0.0, 0.0])
    assert [pose.covariance[i] for i in (0, 6, 11)] == pytest.approx([0.01] * 3)
    assert not [m for m in decode(frames) if m.get_type() == "ODOMETRY"]


def test_raw_observations_are_sent_as_rtcm_in_tunnel_with_shared_sequence_numbers() -> None:
    epoch = PseudorangeReading(
        0, 2200, 345600.0, ("G05", "G12", "E07"), np.array([2.1e7, 2.2e7, 2.5e7]),
        np.array([100.0, -200.0, 50.0]), np.array([45.0, 40.0, 42.0]),
    )  # fmt: skip
    ephemeris = EphemerisReading(0, "G05", wrap_message(bytes.fromhex("3fb0") + bytes(59)))
    frames = Link().frames(0, [epoch, ephemeris], (0,))
    assert [f[4] for f in frames] == list(range(len(frames)))
    reassembler = Reassembler()
    tunnel = message_layout("TUNNEL")
    messages = [
        message
        for raw in frames
        if int.from_bytes(raw[7:10], "little") == tunnel.id
        for message in reassembler.add(tunnel_payload(Frame(raw, tunnel)) or b"")
    ]
    assert [message_number(m) for m in messages] == [1077, 1097, 1019]
    gps = decode_msm7(messages[0])
    assert gps.satellites == ("G05", "G12")
    assert gps.pseudorange_m == pytest.approx((2.1e7, 2.2e7), abs=0.001)
    assert gps.doppler_mps == pytest.approx((100.0, -200.0), abs=0.001)


def test_charge_drawn_adds_up() -> None:
    link = Link()
    link.frames(0, [BatteryReading(0, 16.0, 36.0, 1.0)])
    second = link.frames(1_000_000, [BatteryReading(1_000_000, 16.0, 36.0, 1.0)])
    assert one(second, "BATTERY_STATUS").current_consumed == 10


def test_a_heartbeat_is_sent_once_a_second() -> None:
    link = Link()
    beats = [
        t
        for t in range(0, 3_000_000, 4000)
        if any(m.get_type() == "HEARTBEAT" for m in decode(link.frames(t, [])))
    ]
    assert beats == [0, 1_000_000, 2_000_000]


def test_sequence_numbers_run_through_all_messages() -> None:
    link = Link()
    frames = [f for t in range(0, 1_200_000, 4000) for f in link.frames(t, [], (0,))]
    assert [f[4] for f in frames] == [i % 256 for i in range(len(frames))]


def test_the_packed_layouts_are_those_of_the_dialect() -> None:
    assert frame_kernel.HIL_SENSOR.length == frame_kernel._SENSOR_SIZE
    assert frame_kernel.TRUTH.length == frame_kernel._TRUTH_SIZE


def test_velocities_beyond_the_wire_saturate() -> None:
    link = Link(velocity=[400.0, -400.0, 0.0], air=[500.0, 0.0, 0.0])
    state = one(link.frames(0, []), "HIL_STATE_QUATERNION")
    assert (state.vx, state.vy) == (32767, -32768)
    assert (state.true_airspeed, state.ind_airspeed) == (50_000, 50_000)
    fast = Link(air=[900.0, 0.0, 0.0])
    assert one(fast.frames(0, []), "HIL_STATE_QUATERNION").true_airspeed == 65_535


def test_more_ids_than_the_message_has_room_for_are_refused() -> None:
    link = Link()
    link.board.sensors["id"][1] = 3
    with pytest.raises(AssertionError):
        HilPacker(link.board)
