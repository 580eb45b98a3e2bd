"""The fused state in the pipeline and in the summary of a run."""

import math

import numpy as np

from analysis.monitor.pipeline import Pipeline, monitor_config
from analysis.results import FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import TruthSample
from analysis.scoring.criteria import Criteria
from analysis.scoring.summary_tally import Tally
from mavproxy_fault.numerics.earth import ecef_from_geodetic


def summary(results):
    """The summary of results at a known place."""
    tally = Tally()
    still = np.zeros(3)
    truth = TruthSample(0, np.array([1.0, 0, 0, 0]), still, 47.0, 8.0, 500.0, still)
    tally.add(block_of(truth), [(0, result) for result in results])
    return tally.summary([], {}, Criteria(), 1.0)


def state(up_m):
    """A fused state above the place."""
    lat, lon = math.radians(47.0), math.radians(8.0)
    return FusedState(
        t_us=0,
        position_ecef_m=tuple(ecef_from_geodetic(lat, lon, 500.0 + up_m)),
        velocity_ned_mps=(0.0, 0.0, 0.0),
        q_nb=(1.0, 0.0, 0.0, 0.0),
        position_sigma_m=(1.0, 1.0, 1.0),
        velocity_sigma_mps=(1.0, 1.0, 1.0),
        attitude_sigma_deg=(1.0, 1.0, 1.0),
    )


def test_the_summary_has_the_error_of_the_fused_position():
    assert summary([state(3.0), state(-4.0)])["fused_position_rmse_m"] == 3.536


def test_the_summary_says_nothing_of_fusion_without_it():
    assert "fused_position_rmse_m" not in summary([])


def test_the_pipeline_fuses_where_the_scenario_asks_for_it(flights):
    samples = flights(1.0)
    asked = Pipeline(monitor_config({"fusion": {"lag_s": 2.0}}, "x"))
    fused = [r for s in samples for r in asked.push(s) if isinstance(r, FusedState)]
    assert [round(r.t_s - fused[0].t_s, 6) for r in fused] == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    plain = Pipeline(monitor_config({}, "x"))
    assert not [r for s in samples for r in plain.push(s) if isinstance(r, FusedState)]
