"""A receiver that repeats its fix."""

from itertools import pairwise

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.streams.stream_detector import StreamDetector
from analysis.results import Decision, SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import GpsFix, ImuSample, MagSample, Sample

FREEZES_S, GOES_ON_S, ENDS_S = 40.0, 50.0, 60.0


def hover(noise_m: float = 0.1, every_s: float = 0.2, twice: bool = False) -> Block:
    """Fixes of a hover, frozen between two times; each may be sent twice."""
    rng = np.random.default_rng(1)
    fixes, held = [], np.zeros(5)
    for k in range(round(ENDS_S / every_s)):
        t_s = k * every_s
        new = rng.normal(0.0, noise_m, 5) if not (twice and k % 2) else held
        held = held if FREEZES_S <= t_s < GOES_ON_S else new
        lat, lon, alt, *level = held
        place = 47.0 + lat * 1e-5, 8.0 + lon * 1e-5, 500.0 + alt
        velocity = np.array([*level, 0.0])
        fixes.append(GpsFix(round(t_s * 1e6), *place, velocity, 3, 10, 1.0, 1.5, "HIL_GPS"))
    return block_of(fixes)


def alarms(*blocks: Block) -> list[SensorDecision]:
    watch = StreamDetector()
    state, found = watch.new_state(), []
    for block in blocks:
        results, state = watch.step(block, state)
        found += [result for _, result in results]
    return found


@pytest.mark.parametrize("twice", [False, True])
def test_a_frozen_fix_in_hover_raises_alarms_until_it_recovers(twice: bool) -> None:
    found = alarms(hover(twice=twice))
    assert {(r.sensor, r.alarm, r.isolated) for r in found} == {("gps-position", True, True)}
    assert FREEZES_S + 1.0 < found[0].t_s < FREEZES_S + 4.0
    assert GOES_ON_S - 1.0 < found[-1].t_s < GOES_ON_S


def test_a_receiver_without_noise_may_repeat_itself() -> None:
    assert not alarms(hover(noise_m=0.0))


def test_a_frozen_receiver_is_used_again_after_it_recovers() -> None:
    """A hover that drifts by 3 m while the fix stands, without raw ranges."""
    rng = np.random.default_rng(2)
    samples: list[Sample] = []
    held: tuple[float, ...] = ()
    for k in range(9_000):
        t_s = k * 0.01
        north_m = 0.5 * 0.02 * max(t_s - FREEZES_S, 0.0) ** 2 if t_s < 57.32 else 3.0
        force = np.array([0.02 if FREEZES_S <= t_s < 57.32 else 0.0, 0.0, -9.81])
        samples.append(ImuSample(round(t_s * 1e6), rng.normal(0.0, 1e-3, 3), force))
        if k % 20 == 0:
            samples.append(MagSample(round(t_s * 1e6), np.array([0.21, 0.02, 0.43])))
            if not FREEZES_S <= t_s < 60.0:
                held = (*rng.normal(0.0, 0.05, 3), *rng.normal(0.0, 0.03, 3))
                held = (held[0] + north_m, *held[1:])
            place = 47.0 + held[0] / 111_200.0, 8.0 + held[1] / 75_000.0, 500.0 + held[2]
            alarms = (*place, np.array(held[3:]), 3, 10, 1.0, 1.5, "HIL_GPS")
            samples.append(GpsFix(round(t_s * 1e6), *alarms))
    found = [
        r for r in run_detector(Detector(DetectorConfig()), samples) if isinstance(r, Decision)
    ]
    assert all(d.excluded for d in found if 43.0 < d.t_s < 60.0)
    assert not any(d.excluded or d.alarm for d in found if d.t_s > 73.0)


def test_how_the_stream_is_cut_changes_nothing() -> None:
    block = hover()
    edges = [0, 1, 205, 206, len(block.kind)]
    parts = [block.between(a, b) for a, b in pairwise(edges)]
    assert alarms(*parts) == alarms(block)
