"""The factor graph as an attitude estimator."""

import math

import numpy as np

from analysis.estimators.estimator import Prior
from analysis.estimators.graph_estimator import FusedAttitude
from analysis.samples.sample import Epoch, TruthSample


def angle_deg(q, other):
    """The turn between two attitudes."""
    return math.degrees(2.0 * math.acos(min(1.0, abs(float(np.dot(q, other))))))


def test_the_graph_estimates_attitude_from_imu_and_a_receivers_positions(flights):
    samples = [s for s in flights(8.0, with_fix=True) if not isinstance(s, Epoch)]
    first = next(s for s in samples if isinstance(s, TruthSample))
    estimator = FusedAttitude()
    state = estimator.start(Prior(first.t_us, first.q_nb, first.v_ned_mps))
    off, estimate = [], None
    for sample in samples:
        if isinstance(sample, TruthSample):
            if estimate is not None:
                assert estimate.t_us == sample.t_us
                off.append(angle_deg(estimate.q_nb, sample.q_nb))
        else:
            estimate, state = estimator.update(sample, state)
    assert state.fusion.graph.aligned
    assert len(off) == 41
    assert max(off) < 3.0
