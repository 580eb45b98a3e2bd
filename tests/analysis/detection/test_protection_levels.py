"""Protection levels against least squares written out here, and against a real antenna's place."""

import msgspec
import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.detection.protection_levels import (
    AXES,
    INTEGRITY_RISK,
    ONE_SYSTEM,
    SATELLITE_PRIOR,
    SEVERAL_SYSTEMS,
    bound_position,
    level_factors,
)
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

ANTENNA_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])  # of the data's README
CONFIG = DetectorConfig()


@pytest.fixture(scope="module")
def seen(shared_data):
    """What an epoch of a real recording measured, and the coefficients of its ionosphere."""
    folder = shared_data / "gnss_static"
    samples = read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    first = next(i for i, s in enumerate(samples) if isinstance(s, Epoch))
    detector = Detector(CONFIG)
    _, state = detector.step(samples[: first + 1], detector.new_state())
    chosen = select_ephemerides(samples[first], state.core.broadcast.ephemerides, "GE")
    return observe_epoch(samples[first], chosen), state.core.broadcast.ionosphere


def levels(seen, keep=None, r_m=ANTENNA_M, config=CONFIG):
    observed, ionosphere = seen
    if keep is not None:
        observed = observed.select(np.array([keep(name) for name in observed.satellites]))
    return levels_of(observed, ionosphere, r_m, config)


def levels_of(observed, ionosphere, r_m=ANTENNA_M, config=CONFIG):
    """Horizontal and vertical level of a place, by every satellite observed."""
    x = np.zeros(X_SIZE)
    x[:3] = r_m
    nothing = np.zeros(len(observed.satellites))
    used = predict_innovations(observed, x, config.sigma, ionosphere)
    found = bound_position(
        used, np.zeros(3), nothing, x[:3], VarianceFactor(), config.sigma.slow**2
    )
    return found.hpl_m, found.vpl_m


@pytest.mark.parametrize(("systems", "terms"), [("G", ONE_SYSTEM), ("GE", SEVERAL_SYSTEMS)])
def test_levels_state_their_assumptions(shared_data, systems, terms):
    folder = shared_data / "gnss_static"
    samples = read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    results = run_detector(Detector(DetectorConfig(systems=systems)), samples[:400])
    decisions = [r for r in results if isinstance(r, Decision)]
    assert {d.level_assumes for d in decisions if d.hpl_m is not None} == {terms}
    assert {d.level_assumes for d in decisions if d.hpl_m is None} <= {""}


def test_the_true_position_is_well_within_its_levels(seen):
    horizontal_m, vertical_m = levels(seen)
    assert 5.0 < horizontal_m < 60.0
    assert horizontal_m < vertical_m < 100.0


def test_levels_of_a_wrong_position_reach_the_truth(seen):
    for off in np.eye(3) * 80.0:
        horizontal_m, vertical_m = levels(seen, r_m=ANTENNA_M + off)
        assert horizontal_m**2 + vertical_m**2 > 80.0**2
        before = levels(seen)
        assert horizontal_m > before[0] or vertical_m > before[1]


def test_a_faulty_range_widens_the_levels_by_its_shift_of_the_solution(seen):
    observed, ionosphere = seen
    ranges = observed.measurements.pseudorange_m.copy()
    ranges[0] += 30.0
    moved = observed._replace(measurements=observed.measurements._replace(pseudorange_m=ranges))
    wider = levels_of(moved, ionosphere)
    assert wider[0] > levels(seen)[0]


def test_fewer_satellites_give_wider_levels_and_too_few_none(seen):
    observed, _ = seen
    gps = [name for name in observed.satellites if name[0] == "G"]
    alone = levels(seen, lambda name: name in gps)
    assert np.isfinite(alone[0])
    few = levels(seen, lambda name: name in gps[:6])
    assert few[0] > alone[0]
    assert levels(seen, lambda name: name in gps[:4]) == (np.inf, np.inf)


def test_larger_sigmas_give_wider_levels(seen):
    wide = with_sigma(CONFIG, scale=10.0)
    assert levels(seen, config=wide)[0] > levels(seen)[0]


def with_sigma(config, **changes):
    sigma = msgspec.structs.replace(config.sigma, **changes)
    return msgspec.structs.replace(config, sigma=sigma)


def test_the_factors_are_those_of_the_standards():
    # RTCA DO-229: K_V for a vertical risk of 1e-7.
    assert two_sided_bound(1e-7) == pytest.approx(5.33, abs=0.005)
    healthy, satellite, system = level_factors()[20]
    assert healthy == pytest.approx(two_sided_bound(INTEGRITY_RISK / (AXES * 20)))
    # What is rarely faulty needs a smaller part of the risk.
    assert satellite == pytest.approx(
        two_sided_bound(INTEGRITY_RISK / (AXES * 20) / SATELLITE_PRIOR)
    )
    assert satellite < system < healthy


@pytest.mark.parametrize("off_m", [0.0, 60.0])
def test_the_levels_cover_the_place_of_a_system_that_contradicts_the_one_in_use(seen, off_m):
    observed, ionosphere = seen
    x = np.zeros(X_SIZE)
    x[:3] = ANTENNA_M
    everything = predict_innovations(observed, x, CONFIG.sigma, ionosphere)
    gps = np.array([name[0] == "G" for name in observed.satellites])
    north_m = ned_axes(*geodetic_position(ANTENNA_M)[:2])[0]
    used, rivals = everything.select(gps), everything.select(~gps)
    shift_m = rivals.geometry[:, :3] @ (off_m * north_m)
    rivals = rivals._replace(range_m=rivals.range_m + shift_m)
    nothing, slow = np.zeros(gps.sum()), CONFIG.sigma.slow**2
    alone = bound_position(used, np.zeros(3), nothing, ANTENNA_M, VarianceFactor(), slow)
    both = bound_position(used, np.zeros(3), nothing, ANTENNA_M, VarianceFactor(), slow, rivals)
    assert both.hpl_m > max(off_m, alone.hpl_m if off_m else 0.0)
    # Either place with the same probability; Galileo's own errors move it by some metres.
    sigma_m = np.sqrt(north_m @ (both.lasting_m2 - alone.lasting_m2) @ north_m)
    assert sigma_m == pytest.approx(off_m / np.sqrt(2.0), abs=3.0)
