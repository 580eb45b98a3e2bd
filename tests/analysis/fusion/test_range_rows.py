"""The compiled rows of pseudoranges and rates against GTSAM's own factors and differences."""

import gtsam
import numpy as np
import pytest

from analysis.detection import DetectorConfig
from analysis.detection.filter.measurement import observe_epoch
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.fusion.factors.range_factors import EpochRanges
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph_start import Node, first_guess
from analysis.fusion.local_frame import frame_at
from analysis.fusion.window import variable_key
from analysis.orbits.broadcast import design_matrix
from analysis.samples.sample import Epoch
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

CLOCK = 40.0, 3.0  # what the graph's clock is counted from
OFF_M, FASTER_MPS = np.array([4.0, -7.0, 2.0]), np.array([1.0, 2.0, -3.0])
X, V, C, SECONDS = (variable_key(letter, 0) for letter in "xvcr")


@pytest.fixture(scope="module")
def seen(flights):
    """The ranges of an epoch, a frame, a node some metres off, and weights of which one is 0."""
    references = NavigationDetector()
    state = references.new_state()
    samples = flights(8.0)
    for sample in samples:
        _, state = references.step(sample, state)
    core = state.detector.core
    epoch = [sample for sample in samples if isinstance(sample, Epoch)][-1]
    observed = observe_epoch(epoch, core.broadcast.selection)
    x = core.motion.x
    ranges = EpochRanges(observed, x, core, FusionConfig(), DetectorConfig(), 0)
    frame = frame_at(x[:3] + 30.0, stamp_us=0)
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.5, 2.0), frame.local(x[:3]) + OFF_M)
    node = Node(
        0, epoch.t_us, pose, np.array([9.0, -4.0, 1.0]), gtsam.imuBias.ConstantBias(), CLOCK
    )
    weights = np.linspace(0.0, 1.0, len(ranges.satellites))
    return ranges, frame, node, weights


def rows(ranges, frame, node, weights, rates_only=False):
    """The factor's rows on pose, velocity and clock, and what they should come to."""
    factor = ranges.factor(node, first_guess(node), frame, CLOCK, weights, rates_only)
    linear = factor.toJacobian()
    assert list(linear.keys()) == [X, V, C]
    return linear.jacobian()


def test_the_rows_of_ranges_are_those_of_gtsams_pseudorange_factor(seen):
    ranges, frame, node, weights = seen
    used = np.flatnonzero(weights)
    jacobian, wanted = rows(*seen)
    values = gtsam.Values()
    values.insert(X, node.pose)
    values.insert(SECONDS, 0.0)
    for row, i in enumerate(used):
        sigma = ranges.sigma_m[i] / np.sqrt(weights[i])
        noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
        factor = ranges.pseudorange(i, X, SECONDS, frame, CLOCK, noise)
        theirs, their_wanted = factor.linearize(values).jacobian()
        assert np.allclose(jacobian[row, :6], theirs[0, :6], rtol=0.0, atol=2e-6 / sigma)
        assert np.isclose(jacobian[row, 9], theirs[0, 6] / SPEED_OF_LIGHT_MPS, rtol=1e-12)
        assert np.isclose(wanted[row], their_wanted[0], rtol=0.0, atol=1e-5 / sigma)
    assert not jacobian[: len(used), 6:9].any()
    assert not jacobian[: len(used), 10].any()


def test_the_rows_of_rates_are_those_of_the_detectors_innovations(seen):
    ranges, frame, node, weights = seen
    jacobian, wanted = rows(*seen, rates_only=True)
    faster = node.velocity + FASTER_MPS
    moved = Node(0, node.t_us, node.pose, faster, node.bias, node.clock)
    same, less = rows(ranges, frame, moved, weights, rates_only=True)
    assert len(wanted) == np.count_nonzero(weights)
    assert np.allclose(same, jacobian, atol=1e-12)
    assert np.allclose(wanted - less, jacobian[:, 6:9] @ FASTER_MPS, atol=1e-9)
    assert np.allclose(np.linalg.norm(jacobian[:, 6:9], axis=1), jacobian[:, 10], rtol=1e-9)


def test_without_weights_there_is_no_factor(seen):
    ranges, frame, node, weights = seen
    none = np.zeros_like(weights)
    assert ranges.factor(node, first_guess(node), frame, CLOCK, none, False) is None


def test_the_slow_covariance_is_that_of_least_squares_with_biased_ranges(seen):
    ranges, _, _, weights = seen
    used, share = np.flatnonzero(weights), 0.3
    sigma = share * ranges.sigma_m[used] / FusionConfig().correlation
    design = design_matrix(ranges.los[used], ranges.system[used])
    theirs = np.linalg.inv((design / sigma[:, None]).T @ (design / sigma[:, None]))[:3, :3]
    assert np.allclose(ranges.slow_covariance(weights, share), theirs, rtol=1e-9)


def test_too_few_ranges_have_no_slow_covariance(seen):
    ranges, _, _, weights = seen
    few = weights * (np.arange(len(weights)) < 4)
    assert ranges.slow_covariance(few, 0.3) is None
