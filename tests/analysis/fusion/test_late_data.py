"""Data that come late go where they belong, as long as that is within the lag."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.monitor.pipeline import FILTER, Pipeline, monitor_config
from analysis.results import FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import BaroSample, Epoch, ImuSample

LATE_US = 6_000_000
ARRIVES_US = 6_400_000


def fused(samples, one_by_one=False, **settings):
    """The fused states of a flight, and the pipeline's newest graph; samples in one block, or each
    when it comes."""
    config = monitor_config({"fusion": settings, "attitude": {"estimators": []}}, "x")
    pipeline = Pipeline(config)
    blocks = samples if one_by_one else [block_of(samples)]
    states = [r for block in blocks for r in pipeline.push(block) if isinstance(r, FusedState)]
    return states, pipeline.states[FILTER][1][0].graph


def moved(samples, late, arrives_us):
    """The samples with some of them right after the epoch at a time."""
    gone = {id(sample) for sample in late}
    found = []
    for sample in samples:
        if id(sample) not in gone:
            found.append(sample)
        if isinstance(sample, Epoch) and sample.t_us == arrives_us:
            found += late
    return found


def apart_m(states, others):
    """Distance between solutions at the same times."""
    known = {state.t_us: np.array(state.position_ecef_m) for state in others}
    return {s.t_us: np.linalg.norm(np.array(s.position_ecef_m) - known[s.t_us]) for s in states}


@pytest.fixture(scope="module")
def short(flights):
    """A clean flight."""
    return flights(8.0)


@pytest.fixture(scope="module")
def in_order(short):
    """Its fused states."""
    return fused(short)


def test_a_late_epoch_is_inserted_with_the_same_solution_as_in_time(short, in_order):
    late = [s for s in short if isinstance(s, Epoch) and s.t_us == LATE_US]
    states, graph = fused(moved(short, late, ARRIVES_US))
    reported = [state for state in states if "late" in state.reason]
    assert [state.t_us for state in reported] == [6_600_000]
    assert LATE_US not in {state.t_us for state in states}
    assert LATE_US in {epoch.t_us for epoch in graph.epochs.values()}
    off = apart_m(states, in_order[0])
    assert max(distance for t_us, distance in off.items() if t_us > ARRIVES_US) < 0.05


def test_a_fault_in_a_late_epoch_is_weighted_down(short, in_order):
    late = next(s for s in short if isinstance(s, Epoch) and s.t_us == LATE_US)
    lying = replace(
        late, pseudorange_m=late.pseudorange_m + 60.0 * (np.arange(len(late.satellites)) == 0)
    )
    samples = [lying if s is late else s for s in short]
    states, graph = fused(moved(samples, [lying], ARRIVES_US))
    at = next(epoch for epoch in graph.epochs.values() if epoch.t_us == LATE_US)
    assert at.weights[at.ranges.satellites.index(late.satellites[0])] == 0.0
    off = apart_m(states, in_order[0])
    assert max(distance for t_us, distance in off.items() if t_us > ARRIVES_US) < 0.3


def test_an_epoch_from_before_the_window_is_left_out(short):
    late = [s for s in short if isinstance(s, Epoch) and s.t_us == 1_000_000]
    states, graph = fused(moved(short, late, 7_800_000), lag_s=2.0)
    assert not [state for state in states if "late" in state.reason]
    assert 1_000_000 not in {epoch.t_us for epoch in graph.epochs.values()}


def test_imu_samples_that_come_late_take_the_place_of_the_motion_model(flights):
    samples = flights(10.0)
    hold = [s for s in samples if isinstance(s, ImuSample) and 8_010_000 < s.t_us <= 8_390_000]
    late, graph = fused(moved(samples, hold, 8_600_000), one_by_one=True)
    assert all(s.weights["imu"] == 0.0 for s in late if s.t_us in (8_200_000, 8_400_000))
    edges = {e.t_us: e.edge for e in graph.epochs.values() if e.edge is not None}
    assert all(edges[t_us].uses_imu(0.02) for t_us in (8_200_000, 8_400_000))


def test_imu_samples_out_of_order_between_epochs_change_nothing(short, in_order):
    run = [s for s in short if isinstance(s, ImuSample)]
    swapped = {id(a): b for a, b in zip(run[3::7], run[4::7], strict=False)}
    swapped |= {id(b): a for a, b in zip(run[3::7], run[4::7], strict=False)}
    states, _ = fused([swapped.get(id(s), s) for s in short])
    assert max(apart_m(states, in_order[0]).values()) < 0.05


def test_a_late_barometer_sample_joins_the_epoch_of_its_time(short):
    samples = []
    for sample in short:
        samples.append(sample)
        if isinstance(sample, Epoch) and sample.t_us == ARRIVES_US:
            samples.append(BaroSample(LATE_US, 95_000.0, 540.0))
    _, graph = fused(samples)
    joined = [epoch for source, epoch in graph.window.committed() if source == "baro"]
    assert [graph.epochs[epoch].t_us for epoch in joined] == [LATE_US]
