"""GTSAM fails for real, and the monitor goes on."""

import gtsam
import numpy as np
import pytest

from analysis.fusion.factors.unary_factors import isotropic_noise
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph import Graph
from analysis.fusion.window import FactorWindow, variable_key
from analysis.monitor.pipeline import Pipeline, monitor_config
from analysis.results import Decision, FusedState
from analysis.samples.block import block_of

FAILS_US = 5_000_000


def lost_variable(graph):
    """A factor on a variable that the smoother does not know (any more)."""
    noise = isotropic_noise(1, 1.0)
    graph.attach(
        "lost", graph.node.epoch, gtsam.PriorFactorDouble(variable_key("c", 99_999), 0.0, noise)
    )


def indeterminate(graph):
    """Two variables of which only the difference is measured."""
    values, keys = gtsam.Values(), (variable_key("h", 1), variable_key("h", 2))
    for name in keys:
        values.insert(name, 0.0)
    graph.window.insert(values, keys, graph.seconds(graph.node.t_us))
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 1.0)
    graph.attach("loose", graph.node.epoch, gtsam.BetweenFactorDouble(*keys, 0.0, noise))


def far_off(graph):
    """A measurement of the pose that is 100 m wrong and sure of itself."""
    pose = graph.node.pose
    wrong = gtsam.Pose3(pose.rotation(), pose.translation() + np.array([100.0, 0.0, 0.0]))
    name = variable_key("x", graph.node.epoch)
    graph.attach(
        "wrong", graph.node.epoch, gtsam.PriorFactorPose3(name, wrong, isotropic_noise(6, 1e-3))
    )


def results_of(samples):
    """All results of a fused flight."""
    pipeline = Pipeline(monitor_config({"fusion": {}, "attitude": {"estimators": []}}, "x"))
    return pipeline.push(block_of(samples))


@pytest.fixture(scope="module")
def short(flights):
    """A clean flight."""
    return flights(7.0)


@pytest.mark.parametrize("broken", [lost_variable, indeterminate])
def test_a_failing_graph_is_reported_and_restarts_from_the_filter(broken, monkeypatch, short):
    commit, seen = Graph.commit, []

    def breaking(graph):
        if graph.node.t_us == FAILS_US and not seen:
            seen.append(graph)
            broken(graph)
        commit(graph)

    before = [r for r in results_of(short) if isinstance(r, FusedState)]
    monkeypatch.setattr(Graph, "commit", breaking)
    results = results_of(short)
    states = [r for r in results if isinstance(r, FusedState)]
    reported = [state for state in states if "failed" in state.reason]
    assert [state.t_us for state in reported] == [FAILS_US]
    assert len(states) == len([r for r in results if isinstance(r, Decision)])
    apart = [
        np.linalg.norm(np.subtract(a.position_ecef_m, b.position_ecef_m))
        for a, b in zip(states, before, strict=True)
    ]
    assert max(apart) < 2.0


def test_the_smoother_raises_what_the_step_catches():
    window = FactorWindow(FusionConfig().lag_s)
    window.attach(
        "lost", 0, 0.0, gtsam.PriorFactorDouble(variable_key("c", 7), 0.0, isotropic_noise(1, 1.0))
    )
    with pytest.raises((RuntimeError, ValueError, IndexError)):
        window.commit()


def test_a_graph_that_contradicts_the_filter_reports_the_filters_solution_and_continues(
    monkeypatch, short
):
    commit, seen = Graph.commit, []

    def misled(graph):
        if graph.node.t_us == FAILS_US and not seen:
            seen.append(graph)
            far_off(graph)
        commit(graph)

    monkeypatch.setattr(Graph, "commit", misled)
    results = results_of(short)
    states = [r for r in results if isinstance(r, FusedState)]
    assert seen
    assert [s.t_us for s in states if "from the filter; it was restarted there" in s.reason] == [
        FAILS_US
    ]
    places = {r.t_us: r.position_ecef_m for r in results if isinstance(r, Decision)}
    apart = [np.linalg.norm(np.subtract(s.position_ecef_m, places[s.t_us])) for s in states]
    assert max(apart) < 2.0
