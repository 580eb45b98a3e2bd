"""Two frequencies: the ionosphere-free combination, its delays and noise, and the test of each
satellite by its own two ranges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.filter.measurement import ionosphere_free
from analysis.detection.learn_noise import learn_noise
from analysis.orbits.broadcast import (
    B1I_HZ,
    B3I_HZ,
    E5A_HZ,
    GROUP_DELAY,
    IONOSPHERE,
    NOISE,
    pack_ephemeris,
    packed_for,
)
from analysis.orbits.glonass import CENTRE_HZ, G2_HZ
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.sample import EphemerisSample, Epoch, Sample, Vector
from mavproxy_fault.numerics.constants import L1_HZ

TESTS = Path(__file__).parents[3]
RECORDING = TESTS / "data" / "gnss_two_frequencies" / "roof.obs"
NAVIGATION = TESTS.parent / "simvehicle" / "gnss" / "constellation.nav"
ROOF_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])
L2_HZ, E5B_HZ = 1227.6e6, 1207.14e6
FAULT_S, FREE = 200.0, DetectorConfig(ionosphere_free=True)


@pytest.fixture(scope="module")
def roof() -> list[Sample]:
    return read_rinex_samples(RECORDING, [NAVIGATION])


def epochs_of(samples: list[Sample]) -> list[Epoch]:
    return [s for s in samples if isinstance(s, Epoch)]


def two_ranges(first_hz: float, second_hz: float, range_m: Vector, delay_m: Vector) -> Epoch:
    """Satellites with a delay on L1, on both frequencies."""
    names = tuple(f"G{i + 1:02d}" for i in range(len(range_m)))
    nan = np.full(len(range_m), np.nan)

    def of(hz: float, signal: str, second: Epoch | None = None) -> Epoch:
        ranges = range_m + delay_m * (L1_HZ / hz) ** 2
        carriers, signals = np.full(len(nan), hz), (signal,) * len(nan)
        return Epoch(0, 2149, 0.0, names, ranges, nan, nan, carriers, signals, second)

    return of(first_hz, "1C", of(second_hz, "2W"))


@pytest.mark.parametrize(
    ("first_hz", "second_hz", "factor"),
    # Of the noise, by the standards' ratios 77/60, 154/118, 9/7 and 763/620.
    [
        (L1_HZ, L2_HZ, 2.978),
        (L1_HZ, E5B_HZ, 2.8086),
        (L1_HZ, E5A_HZ, 2.588),
        (CENTRE_HZ, G2_HZ, 2.958),
        (B1I_HZ, B3I_HZ, 3.527),
    ],
)
def test_a_planted_ionospheric_delay_vanishes_and_noise_grows_by_the_known_factor(
    first_hz, second_hz, factor, roof
):
    rng = np.random.default_rng(1)
    range_m, delay_m = rng.uniform(2e7, 2.6e7, 40_000), rng.uniform(1.0, 60.0, 40_000)
    free = ionosphere_free(two_ranges(first_hz, second_hz, range_m, delay_m))
    assert free.pseudorange_m == pytest.approx(range_m, abs=1e-6)
    noisy = two_ranges(first_hz, second_hz, range_m, delay_m)
    ranges = noisy.pseudorange_m + rng.standard_normal(len(range_m))
    assert noisy.second is not None
    other = replace(
        noisy.second, pseudorange_m=noisy.second.pseudorange_m + rng.standard_normal(len(range_m))
    )
    noisy = ionosphere_free(replace(noisy, pseudorange_m=ranges, second=other))
    # A sample of 40,000 knows a standard deviation to 0.35 %; four times that.
    assert np.std(noisy.pseudorange_m - range_m) == pytest.approx(factor, rel=0.014)
    orbit = next(s.ephemeris for s in roof if isinstance(s, EphemerisSample))
    packed = packed_for(pack_ephemeris(orbit), orbit, first_hz, second_hz)
    assert packed[NOISE] == pytest.approx(factor**2, rel=1e-3)
    assert packed[IONOSPHERE] == 0.0


@pytest.mark.parametrize(
    ("name", "first_hz", "second_hz", "second_delay"),
    # The delay of the second range behind the clock, by those of E1 or L1, E5a and E5b: IS-GPS-200N
    # 20.3.3.3.3.2; Galileo OS SIS ICD 2.1, 5.1.5 (the clock is that of E1 and E5b); B3I has none.
    [
        ("G", L1_HZ, L2_HZ, lambda own, _: own * (L1_HZ / L2_HZ) ** 2),
        ("E", L1_HZ, E5B_HZ, lambda own, _: own * (L1_HZ / E5B_HZ) ** 2),
        ("E", L1_HZ, E5A_HZ, lambda own, e5a: own - e5a + e5a * (L1_HZ / E5A_HZ) ** 2),
        ("C", B1I_HZ, B3I_HZ, lambda own, _: 0.0),
    ],
)
def test_the_group_delay_of_a_combination_is_that_of_its_two_ranges(
    name, first_hz, second_hz, second_delay, roof
):
    orbit = next(s.ephemeris for s in roof if isinstance(s, EphemerisSample))
    own_s, e5a_s = 4e-9, 3e-9
    orbit = replace(orbit, satellite=f"{name}11", group_delay_s=own_s, group_delay_e5a_s=e5a_s)
    ratio = (first_hz / second_hz) ** 2
    # Of clocks, as of ranges.
    expected_s = (ratio * own_s - second_delay(own_s, e5a_s)) / (ratio - 1.0)
    if name == "G" or second_hz == E5B_HZ:
        assert expected_s == pytest.approx(0.0, abs=1e-18)
    packed = packed_for(pack_ephemeris(orbit), orbit, first_hz, second_hz)
    assert packed[GROUP_DELAY] == pytest.approx(expected_s, abs=1e-15)


@pytest.mark.parametrize(("system", "signal"), [("G", "5Q"), ("C", "5P"), ("C", "7I"), ("J", "2L")])
def test_a_second_range_whose_delay_is_not_known_is_not_combined(system, signal):
    epoch = two_ranges(L1_HZ, E5A_HZ, np.full(3, 2.2e7), np.ones(3))
    assert len(ionosphere_free(epoch).satellites) == 3
    names = tuple(name.replace("G", system) for name in epoch.satellites)
    assert epoch.second is not None
    second = replace(epoch.second, satellites=names, signals=(signal,) * 3)
    assert ionosphere_free(replace(epoch, satellites=names, second=second)).satellites == ()


def test_second_ranges_on_several_signals_are_not_mixed_on_one_clock():
    epoch = two_ranges(L1_HZ, L2_HZ, np.full(5, 2.2e7), np.ones(5))
    assert epoch.second is not None
    second = replace(epoch.second, signals=("2W", "2L", "2W", "2L", "2W"))
    assert ionosphere_free(replace(epoch, second=second)).satellites == ("G01", "G03", "G05")


def test_both_ranges_of_a_file_are_read(roof):
    for epoch in epochs_of(roof):
        assert epoch.second is not None
        assert epoch.second.satellites == epoch.satellites
        seen = set(zip((n[0] for n in epoch.satellites), epoch.second.signals, strict=True))
        assert {("G", "2W"), ("E", "7Q")} <= seen <= {("G", "2W"), ("E", "7Q"), ("G", "")}
        # The ionosphere delays the second range by more, in the mean.
        assert 0.0 < np.nanmedian(epoch.second.pseudorange_m - epoch.pseudorange_m) < 20.0


def decisions(results: list[Result]) -> list[Decision]:
    return [r for r in results if isinstance(r, Decision)]


def test_the_height_of_a_recording_is_better_with_two_frequencies(roof):
    errors = []
    for config in (DetectorConfig(), FREE):
        learnt = learn_noise(roof, config)
        assert learnt is not None
        places = [d.position_ecef_m for d in decisions(run_detector(Detector(config), roof))]
        assert len(places) == 30
        assert None not in places
        up = ROOF_M / np.linalg.norm(ROOF_M)
        errors.append(abs(float(np.median((np.array(places) - ROOF_M) @ up))))
    assert errors[1] < 0.5 * errors[0]


def with_fault(
    samples: list[Sample], names: tuple[str, ...], metres: float, on: str, for_s: float = 1e6
) -> list:
    """The samples with metres on a range of some satellites from `FAULT_S` on."""
    begin_us, out = epochs_of(samples)[0].t_us + FAULT_S * 1e6, list[Sample]()
    for s in samples:
        faulty = isinstance(s, Epoch) and begin_us <= s.t_us < begin_us + for_s * 1e6
        if isinstance(s, Epoch) and faulty and s.second is not None:
            shift = metres * np.isin(s.satellites, names)
            if on == "first":
                s = replace(s, pseudorange_m=s.pseudorange_m + shift)
            else:
                second = replace(s.second, pseudorange_m=s.second.pseudorange_m + shift)
                s = replace(s, second=second)
        out.append(s)
    return out


def differing(results: list[Result]) -> list[SensorDecision]:
    return [r for r in results if isinstance(r, SensorDecision) and " off that on " in r.reason]


@pytest.mark.parametrize("config", [DetectorConfig(), FREE], ids=["one", "two"])
def test_without_a_fault_no_range_differs_and_no_satellite_is_left_out(roof, config):
    found = run_detector(Detector(config), roof)
    assert differing(found) == []
    assert not any(d.excluded for d in decisions(found))


@pytest.mark.parametrize(
    ("on", "config", "left_out"),
    [
        ("first", DetectorConfig(), True),  # by the other satellites
        ("second", DetectorConfig(), False),  # it is not in use
        ("first", FREE, True),
        ("second", FREE, True),
    ],
)
@pytest.mark.parametrize("name", ["G19", "E13"])
def test_a_fault_on_one_frequency_is_named_with_its_signal(roof, name, on, config, left_out):
    found = run_detector(Detector(config), with_fault(roof, (name,), 20.0, on))
    begin_us = epochs_of(roof)[0].t_us + round(FAULT_S * 1e6)
    named = differing(found)
    assert {r.suspect for r in named} == {name}
    assert {r.t_us for r in named} == {e.t_us for e in epochs_of(roof) if e.t_us >= begin_us}
    second = "2W" if name[0] == "G" else "7Q"
    wrong, other = ("1C", second) if on == "first" else (second, "1C")
    for result in named:
        begin, _, rest = result.reason.partition(" m off that on ")
        assert (begin.rpartition(" ")[0], rest) == (f"its range on {wrong} is", other)
        assert float(begin.rpartition(" ")[2]) == pytest.approx(20.0, abs=3.0)
        assert (result.alarm, result.isolated) == (True, config is FREE)
    for decision in decisions(found):
        expected = (name,) if left_out and decision.t_us >= begin_us else ()
        assert decision.excluded == expected


def test_a_step_of_most_satellites_is_the_receivers_delay_and_no_fault(roof):
    names = epochs_of(roof)[0].satellites
    found = run_detector(Detector(), with_fault(roof, names, 20.0, "second"))
    assert differing(found) == []


@pytest.mark.parametrize("name", ["G19", "E13"])
def test_a_satellite_is_used_again_once_its_difference_is_what_it_was(roof, name):
    found = run_detector(Detector(FREE), with_fault(roof, (name,), 20.0, "second", for_s=5.0))
    fault_us = epochs_of(roof)[0].t_us + round(FAULT_S * 1e6)
    assert [d.t_us for d in decisions(found) if d.excluded] == [fault_us]
    assert [r.suspect for r in differing(found)] == [name]


@pytest.mark.parametrize(("cn0_dbhz", "named"), [(45.0, {"E13"}), (20.0, set())])
def test_a_step_of_a_second_range_counts_by_that_signals_own_strength(roof, cn0_dbhz, named):
    samples = []
    for s in with_fault(roof, ("E13",), 8.0, "second"):
        if isinstance(s, Epoch) and s.second is not None:
            strengths = np.where(np.array(s.satellites) == "E13", cn0_dbhz, 45.0)
            s = replace(s, second=replace(s.second, cn0_dbhz=strengths))
        samples.append(s)
    found = differing(run_detector(Detector(), samples))
    assert {r.suspect for r in found} == named
