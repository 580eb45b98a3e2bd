"""A heading that fixes make believe: a vehicle that hovers does not show which way it points."""

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, PSI, X_Q, X_SIZE
from analysis.detection.receiver.heading import limit_heading_update
from analysis.samples.sample import GpsFix, ImuSample, MagSample, Sample
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

PLACE = (47.0, 8.0, 500.0)
METRES_PER_DEGREE = 111_200.0


def hovering(seconds: float) -> list[Sample]:
    """A vehicle that points north and stands in the air; errors of its receiver last for seconds,
    its tilt sways as if it followed them turned by a right angle."""
    rng, samples, offset_m = np.random.default_rng(6), [], np.zeros(2)
    for step in range(round(seconds * 100)):
        t_us, t_s = step * 10_000, step * 0.01
        phase = 0.8 * t_s
        wrong_mps = 0.12 * np.array([np.sin(phase), 0.0])
        offset_m = offset_m + 0.01 * wrong_mps
        sway_mps2 = 0.12 * 0.8 * np.cos(phase)  # to the east, where the error is to the north
        force = np.array([0.0, sway_mps2, -9.81]) + rng.normal(0.0, 0.05, 3)
        samples.append(ImuSample(t_us, rng.normal(0.0, 2e-3, 3), force))
        if step % 20 == 0:
            v_ned_mps = np.array([*wrong_mps, 0.0]) + rng.normal(0.0, 0.03, 3)
            fix = (PLACE[0] + offset_m[0] / METRES_PER_DEGREE, *PLACE[1:], v_ned_mps)
            samples.append(MagSample(t_us, np.array([0.21, 0.01, 0.43])))
            samples.append(GpsFix(t_us, *fix, 3, 12, 0.8, 1.2, "HIL_GPS"))
    return samples


def heading(motion: MotionEstimate) -> tuple[float, float]:
    """Of a vehicle that points north: how far the heading is off, and its sigma, in rad."""
    lat, lon, _ = geodetic_position(motion.x[0:3])
    axes = ned_axes(lat, lon)
    rotation = axes @ rotation_matrix(motion.x[X_Q : X_Q + 4])
    variance = axes[2] @ motion.p[PSI : PSI + 3, PSI : PSI + 3] @ axes[2]
    return float(np.arctan2(rotation[1, 0], rotation[0, 0])), float(np.sqrt(variance))


def test_a_hover_does_not_make_the_filter_certain_of_a_wrong_heading() -> None:
    detector = Detector(DetectorConfig())
    state = detector.new_state()
    for sample in hovering(90.0):
        _, state = detector.step(sample, state)
    motion = state.core.motion
    assert motion is not None
    assert motion.inertial
    off, sigma = heading(motion)
    assert abs(off) < 2.0 * sigma
    assert sigma > 0.2


@pytest.mark.parametrize(("level_mps2", "sigma"), [(0.01, 0.6), (0.5, 0.4), (4.0, 0.05)])
def test_an_update_gives_no_more_heading_information_than_the_acceleration(
    level_mps2: float, sigma: float
) -> None:
    """Before it 0.6 rad, after it 0.05: what it may have learnt lies between, at 0.2 / 0.5."""
    x = np.zeros(X_SIZE)
    x[0:3], x[X_Q] = (4.2e6, 6.0e5, 4.7e6), 1.0
    lat, lon, _ = geodetic_position(x[0:3])
    axes = ned_axes(lat, lon)
    before, after = (
        MotionEstimate(0, x, variance**2 * np.eye(ERROR_SIZE), inertial=True)
        for variance in (0.6, 0.05)
    )
    kept = limit_heading_update(before, after, np.array([0.0, level_mps2, 3.0]), axes)
    block = axes @ kept.p[PSI : PSI + 3, PSI : PSI + 3] @ axes.T
    assert np.sqrt(np.diag(block)) == pytest.approx([0.05, 0.05, sigma])
    assert np.linalg.eigvalsh(kept.p)[0] > 0.0
