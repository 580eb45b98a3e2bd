"""An IMU found faulty is taken out of the graph, which goes on."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.monitor.pipeline import FILTER, Pipeline, monitor_config
from analysis.results import FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import ImuSample

FROM_US, UNTIL_US = 7_000_000, 8_000_000


@pytest.fixture(scope="module")
def flown(flights):
    """The fused states with an accelerometer that is 8 m/s^2 off for a second, and the graph."""
    pipeline = Pipeline(monitor_config({"fusion": {}, "attitude": {"estimators": []}}, "x"))
    samples = flights(9.0)
    for i, sample in enumerate(samples):
        if isinstance(sample, ImuSample) and FROM_US < sample.t_us <= UNTIL_US:
            accel_b_mps2 = sample.accel_b_mps2 + np.array([8.0, 0.0, 0.0])
            samples[i] = replace(sample, accel_b_mps2=accel_b_mps2)
    states = [r for r in pipeline.push(block_of(samples)) if isinstance(r, FusedState)]
    return states, pipeline.states[FILTER][1][0].graph


def test_the_graph_does_not_restart(flown):
    assert [state.reason for state in flown[0] if state.reason] == ["the graph started"]


def test_the_imu_has_no_weight_from_the_fault_on(flown):
    late = [state for state in flown[0] if state.t_us > FROM_US]
    assert {state.weights["imu"] for state in late} == {0.0}
    before = [state for state in flown[0] if 5_000_000 < state.t_us <= FROM_US]
    assert {state.weights["imu"] for state in before} == {1.0}


def test_edges_since_the_fault_carry_the_motion_model(flown):
    graph = flown[1]
    trusted = {e.t_us: e.edge.trusted for e in graph.epochs.values() if e.edge is not None}
    assert not any(trusted[t_us] for t_us in trusted if t_us > FROM_US)
    assert all(trusted[t_us] for t_us in trusted if 5_000_000 < t_us < FROM_US)


def test_position_stays_and_attitude_gets_less_sure(flown):
    before = next(state for state in flown[0] if state.t_us == FROM_US)
    last = flown[0][-1]
    assert max(last.position_sigma_m) < 2.0 * max(before.position_sigma_m)
    assert max(last.attitude_sigma_deg) > 5.0 * max(before.attitude_sigma_deg)
