"""MAVLink frames to samples."""

import math

import numpy as np
import pytest

from analysis.samples.block import FIX, IMU
from analysis.samples.decoder import Decoder
from analysis.samples.sample import (
    AirspeedSample,
    AttitudeSample,
    BaroSample,
    CommandSample,
    EphemerisSample,
    Epoch,
    GpsFix,
    ImuSample,
    MagSample,
    RangeSample,
    Sample,
    SpareSample,
    TruthSample,
    VisionSample,
)
from mavproxy_fault.rtcm.ephemeris_messages import encode_ephemeris
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame


def frame(name: str, component: int = 51, **values: object) -> Frame:
    layout = message_layout(name)
    return Frame(build_frame(layout, values, component=component), layout)


def samples_of(decoder: Decoder, *frames: Frame) -> list[Sample]:
    return list(decoder.decode(frames).samples())


def tunnel(message: bytes, sequence: int) -> list[Frame]:
    return [Frame(raw, message_layout("TUNNEL")) for raw in tunnel_frames(message, sequence)]


@pytest.mark.parametrize(
    ("bits", "kinds"),
    [
        (0x3F, [ImuSample]),
        (0x1FF, [ImuSample, MagSample]),
        (0x1FFF, [ImuSample, MagSample, BaroSample, AirspeedSample]),
        (0x1F, []),
        (0, []),
    ],
)
def test_hil_sensor_gives_the_fields_of_its_update_bits(bits: int, kinds: list[type]):
    samples = samples_of(Decoder(), frame("HIL_SENSOR", time_usec=5, fields_updated=bits))
    assert [type(sample) for sample in samples] == kinds


def test_hil_sensor_comes_in_si_units():
    imu, mag, baro, air = samples_of(
        Decoder(),
        frame(
            "HIL_SENSOR",
            time_usec=7,
            xacc=1.5,
            zgyro=-0.25,
            ymag=0.5,
            abs_pressure=1000.0,
            diff_pressure=2.0,
            pressure_alt=110.0,
            fields_updated=0x1FFF,
        ),
    )
    assert imu.t_us == 7
    assert imu.accel_b_mps2.tolist() == [1.5, 0.0, 0.0]
    assert imu.gyro_b_rps.tolist() == [0.0, 0.0, -0.25]
    assert mag.field_b_gauss[1] == 0.5
    assert (baro.pressure_pa, baro.pressure_alt_m) == (100_000.0, 110.0)
    assert air.diff_pressure_pa == 200.0


def test_the_other_messages_come_in_si_units():
    decoder = Decoder()
    (fix,) = samples_of(
        decoder,
        frame(
            "HIL_GPS",
            time_usec=9,
            lat=474000000,
            lon=-85000000,
            alt=500_000,
            vn=100,
            vd=-50,
            eph=120,
            epv=65535,
            fix_type=3,
            satellites_visible=11,
        ),
    )
    assert isinstance(fix, GpsFix)
    assert (fix.lat_deg, fix.lon_deg, fix.alt_m) == pytest.approx((47.4, -8.5, 500.0))
    assert fix.v_ned_mps.tolist() == [1.0, 0.0, -0.5]
    assert fix.eph_m == 1.2
    assert math.isnan(fix.epv_m)
    (raw,) = samples_of(decoder, frame("GPS_RAW_INT", vel=1000, cog=9000, fix_type=3, h_acc=800))
    assert raw.v_ned_mps[:2] == pytest.approx([0.0, 10.0], abs=1e-9)
    assert math.isnan(raw.v_ned_mps[2])
    (truth,) = samples_of(
        decoder,
        frame("HIL_STATE_QUATERNION", time_usec=1, attitude_quaternion=[1.0, 0, 0, 0], vx=250),
    )
    assert isinstance(truth, TruthSample)
    assert truth.v_ned_mps[0] == 2.5
    (down,) = samples_of(
        decoder,
        frame(
            "DISTANCE_SENSOR",
            time_boot_ms=3,
            min_distance=10,
            max_distance=5000,
            current_distance=250,
            orientation=25,
        ),
    )
    assert down == RangeSample(3000, 2.5)
    assert (
        samples_of(decoder, frame("DISTANCE_SENSOR", current_distance=250, max_distance=500)) == []
    )
    (odometry,) = samples_of(
        decoder,
        frame(
            "ODOMETRY",
            time_usec=4,
            x=1.0,
            q=[math.sqrt(0.5), 0, 0, math.sqrt(0.5)],
            vx=2.0,
            frame_id=1,
            child_frame_id=12,
        ),
    )
    assert isinstance(odometry, VisionSample)
    assert odometry.v_ned_mps == pytest.approx([0.0, 2.0, 0.0], abs=1e-6)
    (attitude,) = samples_of(
        decoder, frame("ATTITUDE", component=1, time_boot_ms=2, yaw=math.pi / 2)
    )
    assert isinstance(attitude, AttitudeSample)
    assert attitude.q_nb == pytest.approx([math.sqrt(0.5), 0, 0, math.sqrt(0.5)])


@pytest.mark.parametrize("q", [[0.0] * 4, [math.nan] * 4])
def test_odometry_without_an_attitude_is_no_sample(q: list[float]) -> None:
    assert not samples_of(Decoder(), frame("ODOMETRY", time_usec=5, x=1.0, q=q))


def test_ranges_in_tunnel_frames_come_back_with_week_and_time(flight):
    epoch = next(s for s in flight if isinstance(s, Epoch))
    ephemeris = next(s.ephemeris for s in flight if isinstance(s, EphemerisSample))
    decoder = Decoder()
    samples_of(decoder, frame("HIL_SENSOR", time_usec=1_000_000, fields_updated=0x3F))
    samples = []
    for raw in tunnel(encode_ephemeris(ephemeris), 1):
        samples += samples_of(decoder, raw)
    messages = encode_epoch(
        epoch.tow_s, epoch.satellites, epoch.pseudorange_m, epoch.doppler_mps, epoch.cn0_dbhz
    )
    for number, message in enumerate(messages):
        for raw in tunnel(message, 2 + number):
            samples += samples_of(decoder, raw)
    back = samples[-1]
    assert isinstance(samples[0], EphemerisSample)
    assert isinstance(back, Epoch)
    assert len(samples) == 2
    assert (back.t_us, back.week, back.tow_s) == (1_000_000, epoch.week, epoch.tow_s)
    assert sorted(back.satellites) == sorted(epoch.satellites)
    at = [back.satellites.index(name) for name in epoch.satellites]
    assert np.abs(back.pseudorange_m[at] - epoch.pseudorange_m).max() < 0.5e-3


def test_a_late_epoch_keeps_its_own_time(flight):
    epochs = [s for s in flight if isinstance(s, Epoch)][:2]
    decoder = Decoder()
    stamps = []
    for epoch, arrival_us in zip(epochs, (1_000_000, 1_900_000), strict=True):
        samples_of(decoder, frame("HIL_SENSOR", time_usec=arrival_us, fields_updated=0x3F))
        for number, message in enumerate(
            encode_epoch(
                epoch.tow_s,
                epoch.satellites,
                epoch.pseudorange_m,
                epoch.doppler_mps,
                epoch.cn0_dbhz,
            )
        ):
            for raw in tunnel(message, number):
                stamps += [s.t_us for s in samples_of(decoder, raw)]
    assert stamps == [1_000_000, 1_200_000]


def test_broken_rtcm_is_no_sample():
    decoder = Decoder()
    raw = frame("TUNNEL", payload_type=33845, payload_length=30, payload=b"\0" + b"\xd3" * 29)
    assert samples_of(decoder, raw) == []
    assert (
        samples_of(decoder, frame("TUNNEL", payload_type=1, payload_length=3, payload=b"abc")) == []
    )


def test_motor_commands_are_in_thousands() -> None:
    main = {f"servo{i + 1}_raw": 1100 + i for i in range(4)}
    frames = [
        frame("SERVO_OUTPUT_RAW", component=1, time_usec=7, port=0, **main),
        frame("SERVO_OUTPUT_RAW", component=1, time_usec=8, port=1, **main),
        frame("ACTUATOR_OUTPUT_STATUS", component=1, time_usec=9, actuator=[900.0] + 31 * [0.0]),
    ]
    first, second = samples_of(Decoder(), *frames)
    assert isinstance(first, CommandSample)
    assert isinstance(second, CommandSample)
    assert (first.t_us, first.source) == (7, "OUTPUTS")
    assert first.outputs.tolist() == pytest.approx([1.1, 1.101, 1.102, 1.103] + 8 * [0.0])
    assert (second.t_us, second.outputs[0]) == (9, pytest.approx(0.9))


def test_a_distance_that_the_autopilot_sends_on_is_no_second_measurement() -> None:
    def distances(*frames: Frame) -> list[int]:
        return [s.t_us for s in samples_of(decoder, *frames) if isinstance(s, RangeSample)]

    def distance(component: int, ms: int) -> Frame:
        given = {
            "time_boot_ms": ms,
            "current_distance": 300,
            "orientation": 25,
            "max_distance": 900,
        }
        return frame("DISTANCE_SENSOR", component, **given)

    decoder = Decoder()
    assert distances(distance(1, 7)) == [7_000], "without a simulator it is the measurement"
    simulated = frame("HIL_SENSOR", time_usec=10_000, fields_updated=63)
    assert distances(simulated, distance(51, 10), distance(1, 9)) == [10_000]
    assert distances(distance(1, 12), distance(51, 20)) == [20_000]


def test_redundant_imus_and_a_second_receiver_are_distinguished() -> None:
    decoder = Decoder()
    rates = {"xgyro": 100, "time_boot_ms": 5}
    (first,) = samples_of(decoder, frame("SCALED_IMU", **rates))
    (third,) = samples_of(decoder, frame("SCALED_IMU3", **rates))
    assert isinstance(first, ImuSample)
    assert isinstance(third, SpareSample)
    assert (third.kind, third.instance) == (IMU, 2)
    assert third.numbers.tolist() == [*first.gyro_b_rps, *first.accel_b_mps2]
    place = {"lat": 470000000, "lon": 80000000, "alt": 500000, "time_usec": 7}
    (second,) = samples_of(decoder, frame("GPS2_RAW", fix_type=3, **place))
    assert isinstance(second, SpareSample)
    assert (second.kind, second.instance) == (FIX, 1)
    assert second.numbers[:3] == pytest.approx([47.0, 8.0, 500.0])
    assert samples_of(decoder, frame("GPS2_RAW", fix_type=1, **place)) == []
