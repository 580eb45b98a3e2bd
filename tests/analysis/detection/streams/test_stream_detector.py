"""Streams that fall silent, repeat themselves or lose their time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detection.streams.stream_detector import StreamDetector
from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.results import SensorDecision
from analysis.run.proxied_flight import ProxiedFlight
from analysis.samples.block import block_of
from analysis.samples.sample import (
    AttitudeSample,
    BaroSample,
    GpsFix,
    ImuSample,
    MagSample,
    Sample,
    TruthSample,
)
from mavproxy_fault.schedule.entries import Schedule
from simvehicle.scenario.scenario_file import read_scenario

SECOND = 1_000_000
BEGIN_US, END_US = 10 * SECOND, 14 * SECOND  # of what is done to a stream
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def stream(seconds: float = 20, speed_mps: float = 5.0, step_pa: float = 0.0) -> list[Sample]:
    """IMU at 100 Hz, magnetometer and barometer at 50, a receiver at 5, the truth beside them."""
    rng = np.random.default_rng(4)
    still = np.zeros(3)
    samples: list[Sample] = []
    for tick in range(1, round(seconds * 100)):
        t_us = tick * 10_000
        samples.append(ImuSample(t_us, rng.normal(0, 0.01, 3), rng.normal(0, 0.1, 3)))
        if tick % 2 == 0:
            pressure = 95_000.0 + rng.normal(0, 2.0)
            if step_pa:
                pressure = step_pa * round(pressure / step_pa)
            samples += [MagSample(t_us, rng.normal(0.3, 0.002, 3)), BaroSample(t_us, pressure, 0.0)]
        if tick % 20 == 0:
            north_deg = speed_mps * t_us * 1e-6 / 111_000
            v_ned = np.array([speed_mps, 0.0, 0.0])
            fix = GpsFix(t_us, 47 + north_deg, 8.0, 500.0, v_ned, 3, 12, 1.0, 1.0, "HIL_GPS")
            samples.append(fix)
        samples.append(TruthSample(t_us + 1, LEVEL, still, 47.0, 8.0, 500.0, still))
        samples.append(AttitudeSample(t_us + 2, LEVEL, 1, "ATTITUDE"))
    return samples


def troubles(samples: Sequence[Sample]) -> list[SensorDecision]:
    detector = StreamDetector()
    found, _ = detector.step(block_of(samples), detector.new_state())
    return [result for _, result in found]


def changed(kind: type, change: Callable[[Sample], Sample | None]) -> list[Sample]:
    """The stream with something done to one kind of its samples from 10 to 14 s."""
    found = (
        change(sample) if isinstance(sample, kind) and BEGIN_US <= sample.t_us < END_US else sample
        for sample in stream()
    )
    return [sample for sample in found if sample is not None]


def held_axis(sample: Sample) -> Sample:
    assert isinstance(sample, ImuSample)
    return replace(sample, gyro_b_rps=np.array([0.01, *sample.gyro_b_rps[1:]]))


DONE = {
    "silent": (BaroSample, lambda sample: None, "baro", "silent for 0.50 s", 10.48),
    "silent receiver": (GpsFix, lambda sample: None, "gps-position", "silent for 0.99 s", 10.8),
    "frozen": (
        BaroSample,
        lambda sample: replace(sample, pressure_pa=95_000.5),
        *("baro", "the same value for 0.50 s", 10.5),
    ),
    "one axis frozen": (ImuSample, held_axis, "imu", "the same value for 0.50 s", 10.5),
    "frozen while it moves": (
        GpsFix,
        lambda sample: replace(sample, lat_deg=47.0004),
        *("gps-position", "the same value for 1.00 s", 11.0),
    ),
    "time is frozen": (
        MagSample,
        lambda sample: replace(sample, t_us=BEGIN_US),
        *("mag", "its timestamp is frozen", 10.1),
    ),
    "time goes back": (
        ImuSample,
        lambda sample: replace(sample, t_us=sample.t_us - 3 * SECOND),
        *("imu", "its timestamp jumps back by 2.99 s", 10.0),
    ),
    "time jumps ahead": (
        MagSample,
        lambda sample: replace(sample, t_us=sample.t_us + SECOND),
        *("mag", "its timestamp jumps forward by 1.00 s", 10.0),
    ),
}


@pytest.mark.parametrize("case", DONE.values(), ids=DONE.keys())
def test_an_anomalous_stream_is_named_at_once_with_its_reason_and_no_other(case: tuple) -> None:
    kind, change, sensor, reason, t_s = case
    found = troubles(changed(kind, change))
    assert {result.sensor for result in found} == {sensor}
    assert found[0].reason.startswith(reason)
    assert found[0].t_us * 1e-6 == pytest.approx(t_s, abs=0.15)
    assert all(BEGIN_US - 20_000 <= result.t_us <= END_US + SECOND for result in found)


@pytest.mark.parametrize("options", [{}, {"speed_mps": 0.0}, {"step_pa": 4.0}])
def test_a_healthy_stream_raises_no_alarm(options: dict[str, float]) -> None:
    assert troubles(stream(40, **options)) == []


def test_a_value_that_has_repeated_before_may_repeat_again() -> None:
    """A compass that is logged in whole milligauss does not show that a vehicle hovers."""
    rng = np.random.default_rng(4)

    def field(t_us: int) -> Sample:
        hovers = t_us % (10 * SECOND) > SECOND
        return MagSample(t_us, np.full(3, 0.25 if hovers else rng.integers(20, 30) / 100))

    samples = [field(s.t_us) if isinstance(s, MagSample) else s for s in stream(40)]
    assert troubles(samples) == []


def test_the_sensors_of_a_simulator_without_noise_repeat_themselves_at_rest(tmp_path: Path) -> None:
    path = tmp_path / "rest.yaml"
    vehicle = "vehicle: {kind: multirotor, parameters: iris}"
    path.write_text(f"{{{vehicle}, sensors: {{imu: {{rate_hz: 100}}}}, duration_s: 8}}")
    flight, data = ProxiedFlight(read_scenario(path), Schedule()), bytearray()
    while not flight.finished:
        data += flight.advance([]).monitor
    results = Monitor(MonitorConfig()).push_bytes([bytes(data)], datagrams=False)
    assert [r for r in results if isinstance(r, SensorDecision) and r.alarm] == []


def test_fixes_that_an_autopilot_forwards_are_no_stream() -> None:
    samples: list[Sample] = []
    for sample in stream():
        samples.append(sample)
        if isinstance(sample, GpsFix) and sample.t_us > 2 * SECOND:
            late = sample.t_us - 1_200_000 if sample.t_us % SECOND == 0 else sample.t_us
            samples.append(replace(sample, t_us=late, source="GPS_RAW_INT"))
    assert troubles(samples) == []


def test_a_pause_of_everything_is_the_links_fault_alone() -> None:
    found = troubles([s for s in stream() if not BEGIN_US <= s.t_us < END_US])
    assert {result.sensor for result in found} == {"link"}
    first, last = found[0], found[-1]
    assert (first.t_us * 1e-6, last.t_us * 1e-6) == pytest.approx((10.5, 14.0), abs=0.02)


def test_a_pausing_log_is_not_a_lost_link() -> None:
    detector = StreamDetector(link=False)
    block = block_of([s for s in stream() if not BEGIN_US <= s.t_us < END_US])
    assert detector.step(block, detector.new_state())[0] == []


def test_a_stream_received_during_an_unresolved_pause_is_silent_from_then_on() -> None:
    back_us, last_us = BEGIN_US + 600_000, BEGIN_US + 800_000
    found = troubles(
        [
            s
            for s in stream()
            if not BEGIN_US < s.t_us < back_us
            and not (isinstance(s, ImuSample) and s.t_us > last_us)
        ]
    )
    silent = [result for result in found if result.sensor == "imu"]
    assert silent[0].t_us == last_us + SECOND // 2
    assert silent[0].reason == "silent for 0.50 s"


@pytest.mark.parametrize("last_us", [20_000, 40_000, 60_000, 80_000, 100_000])
def test_samples_that_only_show_the_time_do_not_advance_it_over_a_pause(
    last_us: int,
) -> None:
    detector = StreamDetector(link=False)
    slow: dict[type, int] = {
        AttitudeSample: 100_000,
        ImuSample: 40_000,
        MagSample: 100_000,
        BaroSample: 100_000,
    }
    kept = [s for s in stream() if (s.t_us // 10_000 * 10_000) % slow.get(type(s), 200_000) == 0]
    # The IMU goes on a little before the rest, as it comes more often.
    until_us = BEGIN_US + 460_000 + last_us
    block = block_of([s for s in kept if not BEGIN_US + last_us < s.t_us < until_us])
    assert detector.step(block, detector.new_state())[0] == []


def test_sensors_with_a_jumping_clock_raise_an_alarm_and_others_do_not() -> None:
    ahead = (ImuSample, MagSample, GpsFix)
    samples = [
        replace(sample, t_us=sample.t_us + SECOND // 2)
        if isinstance(sample, ahead) and BEGIN_US <= sample.t_us < END_US
        else sample
        for sample in stream()
        if not isinstance(sample, TruthSample | AttitudeSample)
    ]
    found = troubles(samples)
    assert {result.sensor for result in found} == {"imu", "mag", "gps-position"}
    assert {result.reason for result in found} <= {
        *("its timestamp jumps forward by 0.50 s", "its timestamp jumps forward by 0.51 s"),
        *("its timestamp jumps forward by 0.52 s", "its timestamp jumps forward by 0.69 s"),
    }
    assert all(BEGIN_US - 20_000 <= result.t_us <= END_US for result in found)


def test_a_jump_of_one_stream_is_accepted_after_a_second() -> None:
    alone = [s for s in stream() if isinstance(s, MagSample)]
    found = troubles([s for s in alone if not BEGIN_US <= s.t_us < END_US])
    assert {result.sensor for result in found} == {"link"}


def test_blocks_of_any_length_say_the_same() -> None:
    samples = changed(BaroSample, lambda sample: None)
    detector, state = StreamDetector(), StreamDetector().new_state()
    found = []
    for begin in range(0, len(samples), 37):
        results, state = detector.step(block_of(samples[begin : begin + 37]), state)
        found += [result for _, result in results]
    assert found == troubles(samples)


def every_other(samples: Sequence[Sample], *kinds: type) -> list[Sample]:
    """From 10 to 14 s only every other sample of these kinds comes, of each by itself."""
    kept: list[Sample] = []
    came = dict.fromkeys(kinds, 0)
    for sample in samples:
        if isinstance(sample, kinds) and BEGIN_US <= sample.t_us < END_US:
            came[type(sample)] += 1
            if came[type(sample)] % 2:
                continue
        kept.append(sample)
    return kept


def test_a_halved_rate_raises_alarms_until_it_recovers() -> None:
    found = troubles(every_other(stream(), BaroSample))
    assert {result.sensor for result in found} == {"baro"}
    assert found[0].reason.startswith("rate is 0.")
    assert BEGIN_US + SECOND < found[0].t_us < END_US
    assert found[-1].t_us < END_US + 2 * SECOND


def test_when_all_rates_halve_the_link_is_at_fault() -> None:
    kinds = (ImuSample, MagSample, BaroSample, GpsFix)
    assert {result.sensor for result in troubles(every_other(stream(), *kinds))} == {"link"}


def test_a_lasting_rate_becomes_the_usual_one() -> None:
    samples = [
        sample
        for at, sample in enumerate(stream(60))
        if not (isinstance(sample, BaroSample) and sample.t_us > BEGIN_US and at // 5 % 2)
    ]
    found = troubles(samples)
    assert {result.sensor for result in found} == {"baro"}
    assert found[-1].t_us < BEGIN_US + 25 * SECOND


@pytest.mark.parametrize("for_us", [SECOND // 3, 4 * SECOND // 10])
def test_a_short_pause_of_everything_makes_no_stream_sparse(for_us: int) -> None:
    assert troubles([s for s in stream() if not BEGIN_US <= s.t_us < BEGIN_US + for_us]) == []


def test_delayed_samples_that_come_at_once_are_a_burst() -> None:
    samples: list[Sample] = []
    kept: list[Sample] = []
    for sample in stream():
        if isinstance(sample, MagSample) and BEGIN_US <= sample.t_us < END_US:
            kept.append(sample)
            continue
        samples.append(sample)
        if sample.t_us % (SECOND // 4) == 0 and isinstance(sample, ImuSample):
            samples += kept
            kept = []
    found = troubles(samples)
    assert {(result.sensor, result.reason.split(" ", 1)[1]) for result in found} >= {
        ("mag", "samples at once")
    }
    assert {result.sensor for result in found} == {"mag"}


def test_a_receiver_half_a_second_later_than_usual_raises_an_alarm() -> None:
    late = [
        (s.t_us + SECOND // 2 if isinstance(s, GpsFix) and s.t_us >= BEGIN_US else s.t_us, s)
        for s in stream()
    ]
    found = troubles([sample for _, sample in sorted(late, key=lambda arrival: arrival[0])])
    assert {result.sensor for result in found} == {"gps-position"}
    assert found[0].reason == "0.49 s late"  # the newest sample is that of 10 ms before
