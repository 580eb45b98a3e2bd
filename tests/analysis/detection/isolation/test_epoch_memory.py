"""Offsets of healthy satellites: learned, frozen when other satellites are used, faded."""

import math
from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import DetectorConfig, SigmaModel
from analysis.detection.detector import Detector, run_detector
from analysis.detection.filter.information import normal_equations_over
from analysis.detection.isolation.epoch_memory import (
    EpochMemory,
    freeze_offsets,
    frozen_offsets_m,
    learned_offsets_m,
)
from analysis.detection.isolation.ramp_test import new_ramps
from analysis.detection.isolation.ramp_windows import WINDOW_COUNT, learn_offsets
from analysis.results import Decision
from analysis.samples.sample import Epoch, ImuSample, Sample

CONFIG = DetectorConfig()
FOR_EVER = SigmaModel(slow_s=1e12)
NAMES = ("E05", "G12")


def memory_of(offsets_m: list[float]) -> EpochMemory:
    """A memory that has learned these offsets."""
    ramps = new_ramps(0)
    windows = ramps.windows._replace(
        offset=np.array(offsets_m),
        spread=np.ones(2),
        offsets=np.full((WINDOW_COUNT, 2), 0.5),
        spreads=np.ones((WINDOW_COUNT, 2)),
    )
    return EpochMemory(ramps=ramps._replace(names=NAMES, windows=windows))


def test_learned_offsets_are_frozen_and_learned_again_from_zero():
    memory = freeze_offsets(memory_of([1.0, -2.0]), 1_000_000, CONFIG)
    assert frozen_offsets_m(memory.frozen, NAMES, 1_000_000, CONFIG).tolist() == [1.0, -2.0]
    assert learned_offsets_m(memory.ramps, NAMES).tolist() == [0.0, 0.0]
    assert memory.ramps is not None
    assert memory.ramps.windows.offsets.tolist() == [[-0.5, 2.5]] * WINDOW_COUNT


def test_freezing_again_adds_to_what_is_frozen():
    memory = freeze_offsets(memory_of([1.0, -2.0]), 0, CONFIG)
    assert memory.ramps is not None
    windows = memory.ramps.windows._replace(offset=np.array([0.25, 0.0]))
    memory = memory._replace(ramps=memory.ramps._replace(windows=windows))
    frozen = freeze_offsets(memory, 0, CONFIG).frozen
    assert frozen_offsets_m(frozen, NAMES, 0, CONFIG).tolist() == [1.25, -2.0]


def test_frozen_offsets_fade_with_their_correlation_time():
    frozen = freeze_offsets(memory_of([1.0, -2.0]), 0, CONFIG).frozen
    later_us = round(CONFIG.sigma.slow_s * 1e6)
    left_m = frozen_offsets_m(frozen, ("G12", "G30"), later_us, CONFIG)
    assert left_m == pytest.approx([-2.0 / math.e, 0.0])


def test_an_offset_is_learned_as_a_kalman_filter_does():
    rng = np.random.default_rng(2)
    mean, spread = np.zeros(1), np.ones(1)
    h, p = np.zeros((1, 20)), np.zeros((20, 20))
    for _ in range(50):
        v = 0.7 + rng.standard_normal(1)
        windows = new_ramps(0).windows._replace(offset=mean, spread=spread)
        ranges = normal_equations_over(np.arange(20), h, np.ones(1), v, np.ones(1))
        mean, spread = learn_offsets(windows, p, ranges, 1.0, FOR_EVER)
    assert spread[0] == pytest.approx(1.0 / 51.0)
    assert abs(mean[0] - 0.7) < 4.0 * math.sqrt(spread[0])


def without(samples: list[Sample], names: tuple[str, ...], from_us: int) -> list[Sample]:
    """The samples with some satellites gone from a time on."""
    out: list[Sample] = []
    for s in samples:
        if isinstance(s, Epoch) and s.t_us >= from_us:
            keep = [i for i, name in enumerate(s.satellites) if name not in names]
            s = replace(
                s,
                satellites=tuple(s.satellites[i] for i in keep),
                pseudorange_m=s.pseudorange_m[keep],
                doppler_mps=s.doppler_mps[keep],
                cn0_dbhz=s.cn0_dbhz[keep],
            )
        out.append(s)
    return out


def with_offsets(samples: list[Sample]) -> list[Sample]:
    """The samples with each satellite off by its own metres."""
    rng = np.random.default_rng(4)
    names = next(s.satellites for s in samples if isinstance(s, Epoch))
    off = dict(zip(names, rng.normal(0.0, 0.8, len(names)), strict=True))
    return [
        replace(
            s, pseudorange_m=s.pseudorange_m + np.array([off.get(n, 0.0) for n in s.satellites])
        )
        if isinstance(s, Epoch)
        else s
        for s in samples
    ]


def moved_m(samples: list[Sample], config: DetectorConfig) -> float:
    """How far two satellites' setting moves the position on the average of the last ten seconds."""
    names = next(s.satellites for s in samples if isinstance(s, Epoch))[1:4:2]
    ends = []
    for part in (samples, without(samples, names, 40_000_000)):
        found = [r for r in run_detector(Detector(config), part) if isinstance(r, Decision)]
        last = [d.position_ecef_m for d in found if d.t_us >= 50_000_000]
        ends.append(np.mean([r for r in last if r is not None], axis=0))
    return float(np.linalg.norm(ends[1] - ends[0]))


def test_the_position_hardly_moves_when_satellites_set(flight):
    part = with_offsets([s for s in flight if not isinstance(s, ImuSample)])
    forgetful = DetectorConfig(sigma=SigmaModel(slow=0.0), p_slow=1e-100)
    assert moved_m(part, CONFIG) < 0.5 * moved_m(part, forgetful)
