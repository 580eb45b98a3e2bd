"""The smoother on a simulated flight, by its own covariance and with faults in it."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from analysis.detection import DetectorConfig
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.fusion.filter_check import FILTER
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph import Graph
from analysis.fusion.smoother import Fusion
from analysis.results import Decision, FusedState
from analysis.samples.block import split_at_events
from analysis.samples.sample import BaroSample, Epoch, ImuSample, TruthSample
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes

SECONDS = 14.0
FAULT_US, FOUND_US = 9_000_000, 10_000_000
STEP_M = 50.0


def detected(samples):
    """Each sample with what the detector said of it and its state."""
    references = NavigationDetector()
    state = references.new_state()
    rows = []
    for sample in samples:
        results, state = references.step(sample, state)
        rows.append((sample, results, state.detector.core))
    return rows


def fused(rows, config=None):
    """The fused states of a detected flight."""
    fusion = Fusion(config or FusionConfig(), DetectorConfig())
    state = fusion.new_state()
    states = []
    for sample, results, core in rows:
        (piece,) = split_at_events(sample)
        said, state = fusion.step(piece, results, core, state)
        states += said
    return states


def errors(states, samples):
    """Position error north, east, down (n, 3) of the states that have a truth."""
    truths = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
    rows = []
    for state in states:
        truth = truths[state.t_us]
        lat, lon = math.radians(truth.lat_deg), math.radians(truth.lon_deg)
        true_m = np.asarray(ecef_from_geodetic(lat, lon, truth.alt_m))
        rows.append(ned_axes(lat, lon) @ (np.array(state.position_ecef_m) - true_m))
    return np.array(rows)


def rmse(values):
    """Root mean square of the lengths of the rows."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))


def stepped(samples, name):
    """The samples with a satellite's pseudorange wrong from the fault on."""
    return [
        replace(
            s,
            pseudorange_m=s.pseudorange_m + STEP_M * np.array([n == name for n in s.satellites]),
        )
        if isinstance(s, Epoch) and s.t_us >= FAULT_US
        else s
        for s in samples
    ]


@pytest.fixture(scope="module")
def short(flights):
    """A clean flight."""
    return flights(SECONDS)


@pytest.fixture(scope="module")
def clean(short):
    """The clean flight, detected."""
    return detected(short)


@pytest.fixture(scope="module")
def faulty(short):
    """The flight with a faulty satellite, detected; and its name."""
    name = next(s for s in short if isinstance(s, Epoch)).satellites[0]
    return name, detected(stepped(short, name))


@pytest.fixture(scope="module")
def smooth(clean):
    """The fused states of the clean flight."""
    return fused(clean)


def late(states):
    """States at and after the fault."""
    return [state for state in states if state.t_us >= FAULT_US]


def test_every_epoch_gets_a_state_near_the_truth(clean, smooth, short):
    epochs = [r.t_us for _, results, _ in clean for r in results if isinstance(r, Decision)]
    assert [state.t_us for state in smooth] == epochs
    assert rmse(errors(smooth, short)) < 2.0


def test_errors_are_within_three_of_their_own_sigmas(smooth, short):
    shares = np.abs(errors(smooth, short)) / [state.position_sigma_m for state in smooth]
    assert np.mean(shares < 3.0) > 0.97


def test_the_squared_position_error_is_inside_its_95_percent_band(smooth, short):
    found = errors(smooth, short)
    nees = ((found / [state.position_sigma_m for state in smooth]) ** 2).sum(axis=1)
    # Range errors last for seconds, so that the flight holds few independent epochs: of one.
    assert chi2.ppf(0.025, 3) < nees.mean() < chi2.ppf(0.975, 3)


def test_velocity_and_attitude_fit_the_truth(smooth, short):
    truths = {s.t_us: s for s in short if isinstance(s, TruthSample)}
    for state in smooth[-20:]:
        truth = truths[state.t_us]
        off = np.array(state.velocity_ned_mps) - truth.v_ned_mps
        assert np.all(np.abs(off) < 4.0 * np.array(state.velocity_sigma_mps) + 0.1)
        angle = 2.0 * math.acos(min(1.0, abs(float(np.dot(state.q_nb, truth.q_nb)))))
        assert math.degrees(angle) < 4.0 * max(state.attitude_sigma_deg)


def test_a_faulty_satellite_is_excluded_and_leaves_no_error(faulty, smooth, short):
    name, rows = faulty
    states = fused(rows)
    assert all(state.weights[name] == 0.0 for state in late(states))
    assert rmse(errors(late(states), short)) < 1.1 * rmse(errors(late(smooth), short)) + 0.1


def test_without_decisions_the_fault_moves_the_position(faulty, short):
    _, rows = faulty
    believed = late(fused(rows, FusionConfig(decide=False)))
    assert rmse(errors(believed, short)) > 2.0


def test_a_fault_detected_late_is_removed_from_its_epochs(faulty, smooth, short):
    name, rows = faulty
    reported = [
        (sample, [_not_yet(r) for r in results] if sample.t_us < FOUND_US else results, core)
        for sample, results, core in rows
    ]
    states = fused(reported)
    before = [s for s in states if FAULT_US <= s.t_us < FOUND_US]
    after = [s for s in states if s.t_us >= FOUND_US]
    # The graph believes it and leaves the filter, which is without it.
    assert min(state.weights[FILTER] for state in before) < 0.9
    assert all(state.weights[FILTER] == 1.0 for state in smooth if state.t_us < FOUND_US)
    assert all(state.weights[name] == 1.0 for state in before)
    clean_after = [s for s in smooth if s.t_us >= FOUND_US]
    assert rmse(errors(after, short)) < 1.1 * rmse(errors(clean_after, short)) + 0.1


def _not_yet(result):
    """A decision as if nothing had been found."""
    if not isinstance(result, Decision):
        return result
    names = (*result.satellites, *(n for n in result.excluded if n not in result.satellites))
    return msgspec.structs.replace(
        result,
        excluded=(),
        hypothesis="none",
        alarm=False,
        satellites=names,
        normalised=(0.0,) * len(names),
    )


def test_motion_continues_without_the_imu(short):
    gap = [s for s in short if not (isinstance(s, ImuSample) and 9_000_000 < s.t_us < 9_900_000)]
    states = fused(detected(gap))
    blind = [s for s in states if 9_200_000 <= s.t_us <= 9_800_000]
    assert len(blind) == 4
    assert all(state.weights["imu"] == 0.0 for state in blind)
    assert states[-1].weights["imu"] == 1.0
    assert rmse(errors(late(states), short)) < 3.0


def test_a_barometer_that_comes_and_goes_joins_and_leaves(clean):
    with_baro = []
    for sample, results, core in clean:
        if isinstance(sample, Epoch) and 8_000_000 <= sample.t_us < 9_000_000:
            with_baro.append((BaroSample(sample.t_us, 95_000.0, 540.0), [], core))
        with_baro.append((sample, results, core))
    used = {state.t_us for state in fused(with_baro) if "baro" in state.weights}
    assert min(used) == 8_000_000
    assert max(used) == 8_800_000


def test_a_graph_that_fails_is_reported_and_restarts(clean, monkeypatch, short):
    commit, failed = Graph.commit, []

    def breaking(self):
        if self.node.t_us == FAULT_US and not failed:
            failed.append(True)
            raise RuntimeError("Indeterminant linear system detected")
        commit(self)

    monkeypatch.setattr(Graph, "commit", breaking)
    states = fused(clean)
    reported = [state for state in states if "failed" in state.reason]
    assert [state.t_us for state in reported] == [FAULT_US]
    assert "Indeterminant linear system detected" in reported[0].reason
    assert rmse(errors(late(states), short)) < 2.0


def test_a_graph_that_cannot_start_repeats_the_last_state(clean, monkeypatch):
    commit = Graph.commit

    def breaking(self):
        if FAULT_US <= self.node.t_us < FOUND_US:
            raise RuntimeError("no")
        commit(self)

    monkeypatch.setattr(Graph, "commit", breaking)
    states = fused(clean)
    stuck = [state for state in states if "last state" in state.reason]
    assert len(stuck) > 0
    assert len({state.position_ecef_m for state in stuck}) == 1
    assert isinstance(states[-1], FusedState)
    assert states[-1].reason == ""
