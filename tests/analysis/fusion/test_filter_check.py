"""The graph is never worse than the detector's filter: real ranges, and graphs made so."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from analysis.detection import DetectorConfig
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.fusion.filter_check import FILTER, blend_with_filter, filter_contradiction
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph import Graph
from analysis.fusion.graph_start import start_from_filter
from analysis.fusion.smoother import Fusion
from analysis.recordings.read_recordings import read_rinex, read_rinex_samples
from analysis.results import Decision, FusedState
from analysis.samples.block import block_of, split_at_events
from analysis.samples.sample import Epoch, TruthSample
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.schedule.entries import parse_schedule

ANTENNA_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])  # of the data's README
CONFIG = FusionConfig()


def judged(samples, systems):
    """Decisions, fused states, and the detector's last state."""
    config = DetectorConfig(systems=systems)
    references, fusion = NavigationDetector(config), Fusion(CONFIG, config)
    detecting, fusing = references.new_state(), fusion.new_state()
    results = []
    for piece in split_at_events(block_of(samples)):
        found, detecting = references.step_piece(piece, detecting)
        said, fusing = fusion.step(piece, found, detecting.detector.core, fusing)
        results += [*found, *said]
    decisions = [r for r in results if isinstance(r, Decision)]
    return decisions, [r for r in results if isinstance(r, FusedState)], detecting.detector.core


def error_m(results):
    """Root mean square distance from the antenna."""
    offs = [np.subtract(r.position_ecef_m, ANTENNA_M) for r in results]
    return math.sqrt(float(np.mean([off @ off for off in offs])))


def epochs(samples, seconds, change):
    """The samples of the first seconds with every epoch changed, by the seconds since the first."""
    samples = list(samples)
    begin_us = next(s.t_us for s in samples if isinstance(s, Epoch))
    for sample in samples:
        if isinstance(sample, Epoch):
            since_s = (sample.t_us - begin_us) * 1e-6
            if since_s < seconds:
                yield change(sample, since_s)
        else:
            yield sample


@pytest.fixture(scope="module")
def static(shared_data: Path):
    folder = shared_data / "gnss_static"
    return read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")


def test_alternating_exclusions_cost_the_graph_no_more_than_the_filter(static):
    first = next(s for s in static if isinstance(s, Epoch)).satellites
    wrong = [name for name in first if name[0] in "GE"][:6]

    def faulty(epoch, since_s):
        bad = wrong[int(since_s // 50) % 6], wrong[int(since_s // 70 + 3) % 6]
        steps = [60.0 if name in bad and since_s % 50 > 20 else 0.0 for name in epoch.satellites]
        return replace(epoch, pseudorange_m=epoch.pseudorange_m + np.array(steps))

    decisions, states, _ = judged(epochs(static, 300.0, faulty), "GE")
    assert len(states) == len(decisions) == 300
    assert len({d.excluded for d in decisions}) > 10
    for state in states:  # in an order that does not depend on the interpreter's hashes
        zeros = [n for n, weight in state.weights.items() if weight == 0.0 and n[1:].isdigit()]
        assert zeros == sorted(zeros)
    assert error_m(states) < 1.05 * error_m(decisions)


def test_without_satellites_the_graph_stops_and_starts_with_the_filter(static):
    def few(epoch, since_s):
        count = 4 if 50.0 <= since_s < 150.0 else len(epoch.satellites)
        keep = [i for i, name in enumerate(epoch.satellites) if name[0] == "G"][:count]
        return epoch.select(keep)

    decisions, states, _ = judged(epochs(static, 200.0, few), "G")
    begin_s = decisions[0].t_s
    assert not [s.reason for s in states if "failed" in s.reason]
    reported_s = {round(s.t_s - begin_s) for s in states}
    assert reported_s == {*range(50), *range(150, 200)}
    assert error_m(states) < 1.05 * error_m([d for d in decisions if d.position_ecef_m])


def test_without_an_error_bound_of_the_filter_there_is_no_fused_state(shared_data: Path):
    folder = shared_data / "gnss_static"
    obs, nav = folder / "SEPT078M.21O", folder / "SEPT078M.21P"
    jump = {"preset": "gnss-spoof-jump", "at_s": 40, "for_s": 20}
    lines, _ = faulted_lines(obs, parse_schedule({"faults": [jump]}), [nav])
    spoofed = epochs(read_rinex(obs, nav, None, lines).samples(), 80.0, lambda epoch, _: epoch)
    decisions, states, _ = judged(list(spoofed), "GE")
    begin_s = decisions[0].t_s
    assert {round(s.t_s - begin_s) for s in states} == {*range(40), *range(60, 80)}


def test_without_imu_and_doppler_the_fused_position_does_not_lag_in_turns(
    shared_data: Path,
):
    folder = shared_data / "gnss_static"
    obs, nav = folder / "SEPT078M.21O", folder / "SEPT078M.21P"
    # All ranges moved alike are an antenna that is carried about: to and fro, 5 s each way.
    ways = [
        {"at_s": 5 * i, "for_s": 5, "start": 10 * (i % 2), "rate": 2 * (-1) ** i} for i in range(16)
    ]
    walk = {
        "fault": "plant", "target": "PLANT.spoof_north_m[all]", "at_s": 20, "for_s": 80,
        "profile": {"segments": ways},
    }  # fmt: skip
    lines, _ = faulted_lines(obs, parse_schedule({"faults": [walk]}), [nav])
    samples = read_rinex(obs, nav, None, lines).samples()
    decisions, states, _ = judged(epochs(samples, 120.0, lambda epoch, _: epoch), "GE")
    assert {d.alarm for d in decisions} == {False}
    lat, lon, _ = geodetic_position(ANTENNA_M)
    north = ned_axes(lat, lon)[0]
    squares = []
    for results in (states, decisions):
        since_s = [r.t_s - decisions[0].t_s - 20.0 for r in results]
        away_m = [10 - abs(10 - 2 * t % 20) if 0.0 <= t < 80.0 else 0.0 for t in since_s]
        truth = [ANTENNA_M + m * north for m in away_m]
        offs = [math.dist(r.position_ecef_m, at) for r, at in zip(results, truth, strict=True)]
        squares.append(np.mean(np.square(offs)))
    assert squares[0] <= 1.05**2 * squares[1]


@pytest.fixture(scope="module")
def begun(static):
    """A graph that began at the filter, and the filter."""
    *_, core = judged(epochs(static, 20.0, lambda epoch, _: epoch), "GE")
    graph = Graph(start_from_filter(core.motion, CONFIG.correlation), CONFIG, DetectorConfig())
    graph.commit()
    return graph, core.motion


def test_a_graph_that_began_at_the_filter_is_as_good(begun):
    graph, motion = begun
    assert filter_contradiction(graph, motion, CONFIG.correlation) == ""


def test_a_graph_far_from_the_filter_is_reported(begun):
    graph, motion = begun
    x = motion.x.copy()
    x[0] += 100.0
    found = filter_contradiction(graph, motion._replace(x=x), CONFIG.correlation)
    assert "100.0 m" in found
    assert "from the filter" in found


def test_a_graph_with_a_much_larger_sigma_than_the_filter_is_reported(begun):
    graph, motion = begun
    found = filter_contradiction(graph, motion._replace(p=motion.p / 100.0), CONFIG.correlation)
    assert found == "the graph's sigma was 30 times the filter's"


def state_at(x_m: float) -> FusedState:
    return FusedState(
        t_us=0,
        position_ecef_m=(x_m, 0.0, 0.0),
        velocity_ned_mps=(0.0, 0.0, 0.0),
        q_nb=(1.0, 0.0, 0.0, 0.0),
        position_sigma_m=(1.0, 1.0, 1.0),
        velocity_sigma_mps=(1.0, 1.0, 1.0),
        attitude_sigma_deg=(1.0, 1.0, 1.0),
        weights={"G01": 1.0},
    )


@pytest.mark.parametrize(
    ("off_m", "expected_m", "share"), [(0.7, 0.0, 1.0), (1.125, 0.5625, 0.5), (1.6, 1.6, 0.0)]
)
def test_a_graph_indistinguishable_from_the_filter_has_its_position(off_m, expected_m, share):
    decision = Decision(
        t_us=0, statistic=1.0, threshold=9.0, dof=5, p_value=0.5, alarm=False,
        hypothesis="none", position_ecef_m=(0.0, 0.0, 0.0), position_sigma_m=(3.0, 0.0, 0.0),
    )  # fmt: skip
    found = blend_with_filter(state_at(off_m), decision)
    assert found.position_ecef_m[0] == pytest.approx(expected_m)
    assert found.weights == {"G01": 1.0, FILTER: pytest.approx(share)}
    unbounded = msgspec.structs.replace(decision, position_sigma_m=None)
    assert blend_with_filter(state_at(off_m), unbounded) == state_at(off_m)


# Of the seeds 1 to 30 these were worse than the filter, by 1.16, 1.17, 1.12 and 1.13.
@pytest.mark.parametrize("seed", [12, 14, 15, 29])
def test_no_single_flight_costs_the_graph_more_than_the_filter(flights, seed):
    samples = flights(60.0, seed)
    truth = {
        s.t_us: ecef_from_geodetic(math.radians(s.lat_deg), math.radians(s.lon_deg), s.alt_m)
        for s in samples
        if isinstance(s, TruthSample)
    }
    decisions, states, _ = judged(samples, "GE")
    squares = [
        np.mean([math.dist(r.position_ecef_m, truth[r.t_us]) ** 2 for r in results[50:]])
        for results in (states, decisions)
    ]
    assert squares[0] <= 1.05**2 * squares[1]
