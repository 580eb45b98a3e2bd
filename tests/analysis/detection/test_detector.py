"""The whole detector on a simulated flight: faults found, named, repaired, and nothing else."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.results import Decision, SensorDecision
from analysis.run.run_setup import read_setup
from analysis.samples.sample import EphemerisSample, Epoch, ImuSample, Sample, TruthSample
from mavproxy_fault.numerics.earth import ecef_from_geodetic

FROM_S, UNTIL_S = 30.0, 45.0
Ranges = dict[str, Callable[[float], float]]


def decisions(samples: list[Sample], config: DetectorConfig | None = None) -> list[Decision]:
    results = run_detector(Detector(config or DetectorConfig()), samples)
    return [result for result in results if isinstance(result, Decision)]


def with_ranges(samples: list[Sample], faults: Ranges) -> list[Sample]:
    """Metres added to satellites' ranges between FROM_S and UNTIL_S."""
    changed = []
    for sample in samples:
        if isinstance(sample, Epoch) and FROM_S <= sample.t_us * 1e-6 < UNTIL_S:
            ranges = sample.pseudorange_m.copy()
            for name, fault in faults.items():
                ranges[sample.satellites.index(name)] += fault(sample.t_us * 1e-6 - FROM_S)
            sample = replace(sample, pseudorange_m=ranges)
        changed.append(sample)
    return changed


def with_imu(samples: list[Sample], change: Callable[[ImuSample], ImuSample]) -> list[Sample]:
    return [
        change(s) if isinstance(s, ImuSample) and FROM_S <= s.t_us * 1e-6 < UNTIL_S else s
        for s in samples
    ]


def satellites(samples: list[Sample]) -> tuple[str, ...]:
    return next(s.satellites for s in samples if isinstance(s, Epoch))


def errors(samples: list[Sample], found: list[Decision]) -> np.ndarray:
    """Position errors (n,) of the decisions in the fault's window."""
    truth = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
    out = []
    for decision in found:
        if FROM_S <= decision.t_s < UNTIL_S and decision.position_ecef_m is not None:
            at = truth[decision.t_us]
            r = ecef_from_geodetic(np.radians(at.lat_deg), np.radians(at.lon_deg), at.alt_m)
            out.append(np.linalg.norm(np.array(decision.position_ecef_m) - r))
    return np.array(out)


@pytest.fixture(scope="module")
def clean(flight) -> list[Decision]:
    """The decisions of the flight without a fault."""
    return decisions(flight)


def test_a_clean_flight_raises_no_alarm_and_finds_the_attitude(flight, clean):
    assert not any(decision.alarm for decision in clean)
    assert clean[-1].mode == "inertial"
    assert errors(flight, clean).max() < 2.5  # coloured errors of 0.6 m, PDOP below 2


@pytest.mark.parametrize("size_m", [20.0, -50.0])
def test_a_step_on_one_satellite_is_isolated_at_once_and_the_position_stays(
    flight, clean, size_m: float
):
    name = satellites(flight)[3]
    changed = with_ranges(flight, {name: lambda t: size_m})
    found = decisions(changed)
    alarms = [decision for decision in found if decision.alarm]
    assert alarms[0].t_s == FROM_S
    assert alarms[0].hypothesis == "satellites"
    assert alarms[0].excluded == (name,)
    assert all(decision.excluded in ((), (name,)) for decision in found)
    healthy = errors(flight, clean)
    assert np.sqrt((errors(changed, found) ** 2).mean()) < 1.3 * np.sqrt((healthy**2).mean())


def test_a_satellite_is_readmitted_after_it_has_been_healthy(flight):
    name = satellites(flight)[2]
    found = decisions(with_ranges(flight, {name: lambda t: 40.0}))
    out = [decision.t_s for decision in found if name in decision.excluded]
    assert out[0] == FROM_S
    assert out[-1] == pytest.approx(UNTIL_S + DetectorConfig().readmit_s, abs=0.5)


def test_two_satellites_at_once_are_both_found(flight):
    one, two = satellites(flight)[1], satellites(flight)[4]
    found = decisions(with_ranges(flight, {one: lambda t: 50.0, two: lambda t: -50.0}))
    assert next(d for d in found if d.alarm).excluded == tuple(sorted((one, two)))


def test_a_slow_ramp_is_isolated_before_eight_metres_and_repaired(flight, clean):
    name = satellites(flight)[2]
    changed = with_ranges(flight, {name: lambda t: 0.5 * t})
    found = decisions(changed)
    first = next(decision for decision in found if decision.alarm)
    assert first.excluded == (name,)
    assert 0.5 * (first.t_s - FROM_S) < 8.0
    assert first.onset_us is not None
    assert first.onset_us < first.t_us
    healthy = errors(flight, clean)
    assert np.sqrt((errors(changed, found) ** 2).mean()) < 1.3 * np.sqrt((healthy**2).mean())


def test_for_five_faulty_satellites_the_imu_is_not_isolated(flight):
    faults: Ranges = {
        name: (lambda t, k=k: 40.0 * (-1) ** k + 7.0 * k)
        for k, name in enumerate(satellites(flight)[:6])
    }
    found = decisions(with_ranges(flight, faults))
    first = next(decision for decision in found if decision.alarm)
    assert first.hypothesis == "multiple-unknown"
    assert not any(decision.hypothesis == "imu" for decision in found)


def test_a_jump_of_the_receiver_s_clock_is_no_fault(flight):
    faults: Ranges = {}
    for name in satellites(flight):
        faults[name] = lambda t: 299_792.458
    found = decisions(with_ranges(flight, faults))
    assert not any(decision.alarm for decision in found)
    assert next(d.t_s for d in found if d.hypothesis == "clock") == FROM_S


@pytest.mark.parametrize(
    ("gyro_rps", "accel_mps2", "within_s"), [(0.1, 0.0, 3.0), (0.0, 5.0, 0.5), (0.0, 1.0, 3.0)]
)
def test_a_faulty_imu_is_isolated_and_no_satellite(
    flight, gyro_rps: float, accel_mps2: float, within_s: float
):
    changed = with_imu(
        flight,
        lambda s: replace(
            s,
            gyro_b_rps=s.gyro_b_rps + np.array([gyro_rps, 0.0, 0.0]),
            accel_b_mps2=s.accel_b_mps2 + np.array([0.0, accel_mps2, 0.0]),
        ),
    )
    found = decisions(changed)
    first = next(decision for decision in found if decision.alarm)
    assert first.hypothesis == "imu"
    assert first.t_s - FROM_S <= within_s
    assert not any(decision.excluded for decision in found)


def test_a_healthy_imu_is_not_isolated_for_turns_during_its_suspension(flights):
    flight = flights(seconds=48.0)
    changed = [
        replace(s, gyro_b_rps=s.gyro_b_rps + np.array([0.3, 0.0, 0.0]))
        if isinstance(s, ImuSample) and FROM_S <= s.t_us * 1e-6 < FROM_S + 3.0
        else s
        for s in flight
    ]
    found = decisions(changed)
    assert [d.hypothesis for d in found if d.alarm] == ["imu"]
    assert found[-1].mode == "inertial"


@pytest.mark.parametrize("value", [1e20, -3e38, float("nan")])
def test_an_imu_with_absurd_values_is_isolated_and_the_filter_continues(flights, value: float):
    changed = with_imu(
        flights(seconds=40.0), lambda s: replace(s, accel_b_mps2=np.array([0.0, value, 0.0]))
    )
    found = decisions(changed)
    first = next(decision for decision in found if decision.alarm)
    assert (first.hypothesis, first.t_s) == ("imu", FROM_S)
    assert all(np.isfinite(d.position_sigma_m).all() for d in found if d.position_sigma_m)
    assert np.isfinite(errors(changed, found)).all()


def test_a_silent_imu_is_reported_and_satellites_are_still_tested(flight):
    name = satellites(flight)[3]
    silent = [
        s
        for s in with_ranges(flight, {name: lambda t: 50.0 if t > 5.0 else 0.0})
        if not (isinstance(s, ImuSample) and FROM_S <= s.t_us * 1e-6 < UNTIL_S)
    ]
    results = run_detector(Detector(DetectorConfig()), silent)
    imu = [r for r in results if isinstance(r, SensorDecision) and r.sensor == "imu" and r.alarm]
    assert imu[0].reason.startswith("no IMU samples")
    assert imu[0].t_s == pytest.approx(FROM_S + 0.2)
    out = [r for r in results if isinstance(r, Decision) and r.excluded]
    assert out[0].excluded == (name,)
    assert out[0].t_s == pytest.approx(FROM_S + 5.2)


def test_without_an_imu_a_step_is_still_isolated(flight):
    name = satellites(flight)[3]
    changed = with_ranges(flight, {name: lambda t: 50.0})
    found = decisions([s for s in changed if not isinstance(s, ImuSample)])
    first = next(decision for decision in found if decision.alarm)
    assert (first.t_s, first.excluded) == (FROM_S, (name,))


def test_the_same_samples_give_the_same_results(flight):
    part = flight[:3000]
    assert decisions(part) == decisions(part)


def _epoch(flight: list[Sample]) -> tuple[list[Sample], Epoch]:
    until = [i for i, s in enumerate(flight) if isinstance(s, Epoch)][20]
    return flight[:until], flight[until]  # type: ignore[return-value]


def test_bad_input_is_untestable_with_its_reason_and_the_next_epoch_is_tested(flight):
    before, good = _epoch(flight)
    four = replace(
        good,
        satellites=good.satellites[:2],
        pseudorange_m=good.pseudorange_m[:2],
        doppler_mps=good.doppler_mps[:2],
        cn0_dbhz=good.cn0_dbhz[:2],
    )
    cases = [
        (replace(good, week=good.week + 5), "GPS week"),
        (replace(good, tow_s=float("nan")), "time of week"),
        (replace(good, pseudorange_m=good.pseudorange_m * np.nan), "plausible pseudorange"),
        (four, "healthy satellites"),
        (replace(good, t_us=good.t_us - 400_000), "time went back"),
    ]
    for bad, reason in cases:
        after = replace(good, t_us=good.t_us + 1000, tow_s=good.tow_s + 0.001)
        last = decisions([*before, bad, after])[-2:]
        assert last[0].hypothesis == "untestable"
        assert reason in last[0].reason
        assert last[1].hypothesis != "untestable"


def test_after_a_gap_of_epochs_the_filter_restarts_and_tests_again(flight):
    epochs = [s.t_us for s in flight if isinstance(s, Epoch)]
    silent = [s for s in flight if not (isinstance(s, Epoch) and 20e6 < s.t_us < 35e6)]
    found = decisions(silent)
    again = next(d for d in found if d.t_us >= 35e6)
    assert again.mode == "start"
    assert again.hypothesis == "none"
    assert [d.hypothesis for d in found if d.t_us > again.t_us] == ["none"] * sum(
        t > again.t_us for t in epochs
    )


def test_a_satellite_without_an_ephemeris_is_not_used(flight):
    name = satellites(flight)[0]
    without = [
        s for s in flight if not (isinstance(s, EphemerisSample) and s.ephemeris.satellite == name)
    ]
    found = decisions(without[:4000])
    assert {d.hypothesis for d in found} == {"none"}
    assert all(name not in d.satellites for d in found)


def test_residuals_of_an_excluded_satellite_are_in_every_decision(flight):
    name = satellites(flight)[3]
    found = decisions(with_ranges(flight, {name: lambda t: 50.0}))
    for decision in found:
        if decision.excluded and decision.t_s < UNTIL_S:
            residual = decision.residual_m[decision.satellites.index(name)]
            assert residual == pytest.approx(50.0, abs=8.0)


def test_without_ephemerides_nothing_is_tested(flight):
    epochs = [s for s in flight if isinstance(s, Epoch)][:3]
    found = decisions(list(epochs))
    assert {d.reason for d in found} == {"no ephemeris for any satellite in view"}


def test_a_wrong_doppler_rate_of_one_satellite_is_reported_and_its_range_stays_in_use(flight):
    name = satellites(flight)[2]

    def faulty(sample: Sample) -> Sample:
        if not isinstance(sample, Epoch) or not FROM_S <= sample.t_us * 1e-6 < UNTIL_S:
            return sample
        rates = sample.doppler_mps.copy()
        rates[sample.satellites.index(name)] += 5.0
        return replace(sample, doppler_mps=rates)

    results = run_detector(Detector(), [faulty(sample) for sample in flight])
    reported = [r for r in results if isinstance(r, SensorDecision) and r.sensor == "satellites"]
    assert {result.suspect for result in reported} == {name}
    spacing_s = 1e-6 * np.diff([s.t_us for s in flight if isinstance(s, Epoch)]).max()
    # At the third epoch in a row, so that one noisy epoch isolates no satellite.
    assert FROM_S + 1.5 * spacing_s < reported[0].t_s < FROM_S + 2.5 * spacing_s
    assert UNTIL_S - 1.5 * spacing_s < reported[-1].t_s < UNTIL_S
    assert not any(r.excluded for r in results if isinstance(r, Decision))
    clean = run_detector(Detector(), flight)
    assert not any(isinstance(r, SensorDecision) and r.sensor == "satellites" for r in clean)


@pytest.mark.parametrize("epoch_steps", [10, 20, 200, 400])
def test_epochs_at_twenty_ten_one_and_half_a_hertz_need_no_setting(flights, epoch_steps: int):
    samples = flights(50.0, epoch_steps=epoch_steps)
    assert not any(decision.alarm for decision in decisions(samples))
    name = satellites(samples)[3]
    found = decisions(with_ranges(samples, {name: lambda t: 50.0}))
    acting = [decision for decision in found if FROM_S <= decision.t_s < UNTIL_S]
    assert acting[0].alarm
    assert {decision.excluded for decision in acting} == {(name,)}
    assert errors(samples, found).max() < 3.0


def test_the_prediction_s_share_of_the_main_test_is_chi_square_with_the_noise_of_the_scenario(
    flight,
):
    config = read_setup(None).monitor.detector
    found = [d for d in decisions(flight, config) if d.mode == "inertial"]
    more = sum(d.statistic - d.parity_statistic for d in found)
    dof = sum(d.dof - d.parity_dof for d in found)
    assert abs(more / dof - 1.0) < 3.0 * (2.0 / dof) ** 0.5
