"""Errors of position, velocity and attitude over their own sigmas, on clean flights."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from analysis.monitor.pipeline import Pipeline, monitor_config
from analysis.results import FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import TruthSample
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat

SEEDS = 21, 22, 23
SECONDS, SETTLED_US = 20.0, 12_000_000
KINDS = "position", "velocity", "attitude"


def normalised_squares(state, truth):
    """Squared errors of position, velocity and attitude over their reported variances (3,)."""
    lat, lon = math.radians(truth.lat_deg), math.radians(truth.lon_deg)
    true_m = np.asarray(ecef_from_geodetic(lat, lon, truth.alt_m))
    off_m = ned_axes(lat, lon) @ (np.array(state.position_ecef_m) - true_m)
    off_mps = np.array(state.velocity_ned_mps) - truth.v_ned_mps
    turn = matrix_from_quat(truth.q_nb).T @ matrix_from_quat(np.array(state.q_nb))
    off_deg = np.degrees(0.5 * (turn - turn.T)[[2, 0, 1], [1, 2, 0]])  # small, about body axes
    sigmas = state.position_sigma_m, state.velocity_sigma_mps, state.attitude_sigma_deg
    return [
        np.sum((off / s) ** 2) for off, s in zip((off_m, off_mps, off_deg), sigmas, strict=True)
    ]


@pytest.fixture(scope="module")
def squares(flights):
    """Mean normalised squared errors of each flight (n, 3), once it has settled."""
    rows = []
    for seed in SEEDS:
        samples = flights(SECONDS, seed)
        truths = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
        pipeline = Pipeline(monitor_config({"fusion": {}, "attitude": {"estimators": []}}, "x"))
        states = [r for r in pipeline.push(block_of(samples)) if isinstance(r, FusedState)]
        late = [state for state in states if state.t_us >= SETTLED_US]
        rows.append(np.mean([normalised_squares(s, truths[s.t_us]) for s in late], axis=0))
    return np.array(rows)


@pytest.mark.parametrize("kind", KINDS)
def test_squared_errors_are_inside_their_95_percent_band(kind, squares):
    # Errors last for seconds: a flight counts as one independent epoch.
    flights = len(SEEDS)
    low, high = chi2.ppf([0.025, 0.975], 3 * flights) / flights
    assert low < squares[:, KINDS.index(kind)].mean() < high
