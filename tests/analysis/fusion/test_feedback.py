"""The detector goes on from the smoother, and still finds what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.detection.filter.inertial import CLOCK, ISB, PSI, R, V
from analysis.fusion.feedback import feed_back
from analysis.monitor.filter_step import WITHOUT_ISOLATION
from analysis.monitor.pipeline import FILTER, Pipeline, monitor_config
from analysis.results import Decision, FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import Epoch

FAULT_US = 6_000_000


def pushed(samples, **settings):
    """The pipeline after a flight, and its results."""
    config = monitor_config({"fusion": settings, "attitude": {"estimators": []}}, "x")
    pipeline = Pipeline(config)
    return pipeline, pipeline.push(block_of(samples))


def decisions(results):
    """The detector's decisions."""
    return [result for result in results if isinstance(result, Decision)]


def stepped(samples, name, metres):
    """The samples with a satellite's pseudorange wrong from the fault on."""
    return [
        replace(
            s,
            pseudorange_m=s.pseudorange_m + metres * np.array([n == name for n in s.satellites]),
        )
        if isinstance(s, Epoch) and s.t_us >= FAULT_US
        else s
        for s in samples
    ]


@pytest.fixture(scope="module")
def short(flights):
    """A clean flight."""
    return flights(8.0)


@pytest.fixture(scope="module")
def fed(short):
    """The pipeline and results with feedback."""
    return pushed(short, feedback=True)


def test_the_filter_takes_the_place_of_the_newest_node_with_its_covariance(fed):
    pipeline, results = fed
    graph = pipeline.states[FILTER][1][0].graph
    core = pipeline.states[FILTER][0].detector.core
    state = [result for result in results if isinstance(result, FusedState)][-1]
    assert np.allclose(core.motion.x[R : R + 3], state.position_ecef_m, atol=1e-6)
    to_body = graph.node.pose.rotation().matrix().T @ graph.frame.axes
    for at, block in ((PSI, slice(0, 3)), (R, slice(3, 6))):
        own = to_body @ core.motion.p[at : at + 3, at : at + 3] @ to_body.T
        assert np.allclose(own, graph.covariance[block, block], rtol=0.05, atol=1e-4)
    speed = graph.frame.axes @ core.motion.p[V : V + 3, V : V + 3] @ graph.frame.axes.T
    assert np.allclose(speed, graph.covariance[6:, 6:], rtol=0.05, atol=1e-4)
    assert core.motion.p[ISB, CLOCK] == 0.0 < core.motion.p[ISB, ISB]


def test_without_a_graph_the_filter_stays(fed):
    core = fed[0].states[FILTER][0].detector.core
    assert feed_back(core, None) is core


def test_a_clean_flight_raises_no_alarm_with_feedback(fed):
    assert not [decision for decision in decisions(fed[1]) if decision.alarm]


def test_a_step_is_isolated_at_once_with_feedback(short):
    name = next(s for s in short if isinstance(s, Epoch)).satellites[0]
    _, results = pushed(stepped(short, name, 30.0), feedback=True)
    late = [decision for decision in decisions(results) if decision.t_us >= FAULT_US]
    assert {decision.excluded for decision in late} == {(name,)}


def test_a_graph_without_isolation_runs_beside_where_it_is_asked_for(short):
    name = next(s for s in short if isinstance(s, Epoch)).satellites[0]
    _, results = pushed(stepped(short, name, 50.0), compare=True)
    states = {
        kind: [r for r in results if isinstance(r, FusedState) and r.name == kind]
        for kind in ("fused", WITHOUT_ISOLATION)
    }
    assert len(states["fused"]) == len(states[WITHOUT_ISOLATION]) == len(decisions(results))
    last, believing = (found[-1] for found in states.values())
    assert last.weights[name] == 0.0
    assert believing.weights[name] == 1.0
    apart = np.subtract(last.position_ecef_m, believing.position_ecef_m)
    assert np.linalg.norm(apart) > 3.0
