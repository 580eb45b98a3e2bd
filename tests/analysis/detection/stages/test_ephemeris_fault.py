"""A wrong ephemeris is found as such, and its satellite stays in use."""

from dataclasses import replace
from pathlib import Path

import pytest

from analysis.detection import Detector
from analysis.detection.detector import run_detector
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import EphemerisSample, Epoch, Sample
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

LATE_S = 60.0


@pytest.fixture(scope="module")
def static(shared_data: Path) -> list[Sample]:
    """Two minutes of a fixed antenna."""
    folder = shared_data / "gnss_static"
    samples = read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    begin_us = next(s.t_us for s in samples if isinstance(s, Epoch))
    return [s for s in samples if not isinstance(s, Epoch) or s.t_us < begin_us + 120e6]


def with_broadcast(samples: list[Sample], satellite: str, **changes: float) -> list[Sample]:
    """The samples with an ephemeris of a satellite that is received in the middle: the nearest one
    with other numbers."""
    epochs = [s for s in samples if isinstance(s, Epoch)]
    at_us = epochs[0].t_us + round(LATE_S * 1e6)
    known = [
        s.ephemeris
        for s in samples
        if isinstance(s, EphemerisSample) and s.ephemeris.satellite == satellite
    ]
    near = min(known, key=lambda e: abs(e.toe_s - epochs[0].tow_s))
    assert isinstance(near, Ephemeris)
    new = EphemerisSample(at_us, replace(near, **changes))
    middle = next(i for i, s in enumerate(samples) if isinstance(s, Epoch) and s.t_us >= at_us)
    return [*samples[:middle], new, *samples[middle:]]


def decisions(samples: list[Sample]) -> list[Decision]:
    return [r for r in run_detector(Detector(), samples) if isinstance(r, Decision)]


def test_a_new_ephemeris_with_a_wrong_orbit_is_named_and_the_satellite_stays(
    static: list[Sample],
) -> None:
    first = next(s for s in static if isinstance(s, Epoch))
    # The numbers of a minute earlier; nearer in time than the one in use.
    name, later_s = "G28", first.tow_s + LATE_S
    wrong = with_broadcast(static, name, toe_s=later_s, toc_s=later_s)
    found = decisions(wrong)
    named = [d for d in found if d.hypothesis == "ephemeris"]
    assert len(named) == 1
    assert named[0].alarm
    assert f"ephemeris of {name} of " in named[0].reason
    assert named[0].t_us - found[0].t_us == round(LATE_S * 1e6)
    assert not any(d.excluded for d in found)
    assert not any(d.hypothesis == "satellites" for d in found)


def test_a_range_that_no_ephemeris_explains_excludes_the_satellite(static: list[Sample]) -> None:
    first = next(s for s in static if isinstance(s, Epoch))
    other = with_broadcast(static, "G28", toe_s=first.tow_s - 7100.0)
    late_us, shifted = first.t_us + round(LATE_S * 1e6), list[Sample]()
    for sample in other:
        if isinstance(sample, Epoch) and sample.t_us >= late_us and "G28" in sample.satellites:
            ranges = sample.pseudorange_m.copy()
            ranges[sample.satellites.index("G28")] += 50.0
            sample = replace(sample, pseudorange_m=ranges)
        shifted.append(sample)
    found = decisions(shifted)
    assert found[-1].excluded == ("G28",)
    assert not any(d.hypothesis == "ephemeris" for d in found)


def test_an_ephemeris_of_three_hours_later_is_not_used_and_the_decision_says_so(
    static: list[Sample],
) -> None:
    first = next(s for s in static if isinstance(s, Epoch))
    name = next(n for n in first.satellites if n[0] == "E")
    early = [
        replace(s, ephemeris=replace(s.ephemeris, toe_s=s.ephemeris.toe_s + 10_800.0))
        if isinstance(s, EphemerisSample) and s.ephemeris.satellite == name
        else s
        for s in static
    ]
    found = decisions(early)
    assert all("h early" in d.unused[name] for d in found)
    assert not any(d.excluded or d.alarm for d in found)


def test_a_replay_keeps_the_ephemerides_received_meanwhile(static: list[Sample]) -> None:
    epochs = [s for s in static if isinstance(s, Epoch)]
    begin_us, samples = epochs[0].t_us, list[Sample]()
    new = next(s for s in static if isinstance(s, EphemerisSample))
    received = replace(new.ephemeris, toe_s=new.ephemeris.toe_s + 16.0)
    for sample in static:
        # A ramp that is found seconds after it began, and an ephemeris in between.
        if isinstance(sample, Epoch) and sample.t_us - begin_us >= 40e6:
            ranges = sample.pseudorange_m.copy()
            since_s = (sample.t_us - begin_us) * 1e-6 - 40.0
            ranges[sample.satellites.index("G28")] += 1.0 * since_s
            sample = replace(sample, pseudorange_m=ranges)
            if since_s == 2.0:
                samples.append(EphemerisSample(sample.t_us, received))
        samples.append(sample)
    detector, late = Detector(), False
    state = detector.new_state()
    for sample in samples:
        results, state = detector.step(sample, state)
        for result in results:
            if isinstance(result, Decision) and result.onset_us is not None:
                late |= result.t_us > result.onset_us
    assert late
    stored = state.core.broadcast.ephemerides[received.satellite]
    assert received in [ephemeris for ephemeris, _ in stored]
