"""Sources beside IMU and ranges: each at its own rate, late, gone and back, and lying."""

import math
from dataclasses import replace

import numpy as np
import pytest

from analysis.detection.sensors.sensor_models import density_kgpm3
from analysis.fusion.factors.unary_factors import OFFSET_UNIT_M
from analysis.fusion.local_frame import frame_at
from analysis.fusion.window import variable_key
from analysis.monitor.pipeline import FILTER, Pipeline, monitor_config
from analysis.results import FusedState
from analysis.samples.block import block_of
from analysis.samples.sample import (
    AirspeedSample,
    BaroSample,
    Epoch,
    ImuSample,
    MagSample,
    TruthSample,
    VisionSample,
)
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat

SECONDS = 10.0
LATE_US = 6_000_000
WIND_NED_MPS = np.array([3.0, -2.0, 0.0])
JUMP_US, JUMP_M = 8_000_000, 2.0
ORIGIN_M = np.array([20.0, -5.0, 3.0])  # of vision


def place_m(truth):
    """A truth's position in ECEF."""
    lat, lon = math.radians(truth.lat_deg), math.radians(truth.lon_deg)
    return np.asarray(ecef_from_geodetic(lat, lon, truth.alt_m))


def with_sources(samples):
    """The flight with barometer and vision at 2.5 Hz, magnetometer and airspeed at 5 Hz.

    Vision has an origin of its own, the barometer an offset of 40 m; there is wind.
    """
    rng = np.random.default_rng(4)
    first = next(s for s in samples if isinstance(s, TruthSample))
    frame = frame_at(place_m(first), first.t_us)
    field_ned = np.array([1.0, 1.0, -1.0]) * frame.field_gauss[[1, 0, 2]]
    to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    found = []
    truths = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
    for sample in samples:
        truth = truths.get(sample.t_us) if isinstance(sample, ImuSample) else None
        if truth is not None:
            t_us, rot = sample.t_us, matrix_from_quat(truth.q_nb)
            air = np.linalg.norm(truth.v_ned_mps - WIND_NED_MPS) + rng.normal(0.0, 0.3)
            found.append(MagSample(t_us, rot.T @ field_ned + rng.normal(0.0, 0.005, 3)))
            found.append(AirspeedSample(t_us, 0.5 * density_kgpm3(truth.alt_m) * air**2))
            if t_us % 400_000 == 0:
                up_m = truth.alt_m + 40.0 + rng.normal(0.0, 0.3)
                pressure = 101_325.0 * (1.0 - 2.25577e-5 * up_m) ** 5.25588
                found.append(BaroSample(t_us, pressure, up_m))
                r_m = to_ned @ frame.local(place_m(truth)) - ORIGIN_M + rng.normal(0.0, 0.05, 3)
                found.append(VisionSample(t_us, r_m, None, truth.q_nb))
        found.append(sample)
    return found


def flown(samples, **settings):
    """The fused states of a flight, and the newest graph."""
    values = {"fusion": settings, "attitude": {"estimators": []}}
    pipeline = Pipeline(monitor_config(values, "x"))
    states = [r for r in pipeline.push(block_of(samples)) if isinstance(r, FusedState)]
    return states, pipeline.states[FILTER][1][0].graph


def used(states, source):
    """Times at which a source had a weight."""
    return {state.t_us for state in states if state.weights.get(source, 0.0) > 0.0}


def errors(states, samples):
    """Position errors (n,) by time."""
    truths = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
    return {
        s.t_us: float(np.linalg.norm(np.array(s.position_ecef_m) - place_m(truths[s.t_us])))
        for s in states
    }


@pytest.fixture(scope="module")
def plain(flights):
    """The flight without other sources: its samples and states."""
    samples = flights(SECONDS)
    return samples, flown(samples)[0]


@pytest.fixture(scope="module")
def rich(plain):
    """The flight with them: its samples, states and graph."""
    samples = with_sources(plain[0])
    return samples, *flown(samples)


def test_each_source_has_factors_at_its_own_rate(rich):
    _, states, graph = rich
    late = {state.t_us for state in states if state.t_us > 5_000_000}
    slow = {t_us for t_us in late if t_us % 400_000 == 0}
    assert used(states, "mag") >= late
    assert used(states, "airspeed") >= late
    assert used(states, "baro") & late == slow
    assert used(states, "vision") & late == slow
    names = {name for name, _ in graph.window.committed()}
    assert {"imu", "clock", "ranges", "mag", "airspeed", "baro", "vision", "h", "w"} <= names


def test_they_make_the_solution_surer_and_no_worse(plain, rich):
    last, richer = plain[1][-1], rich[1][-1]
    assert richer.attitude_sigma_deg[2] < 0.7 * last.attitude_sigma_deg[2]
    assert max(richer.position_sigma_m) < 1.01 * max(last.position_sigma_m)
    off, better = (list(errors(s, plain[0]).values())[-20:] for s in (plain[1], rich[1]))
    assert np.mean(better) < np.mean(off) + 0.3


def test_the_barometers_offset_and_the_wind_are_found(rich):
    _, _, graph = rich
    smoother, span = graph.window.smoother, graph.span(graph.node.epoch)
    offset_m = OFFSET_UNIT_M * float(smoother.calculateEstimateVector(variable_key("h", span))[0])
    assert abs(offset_m - 40.0) < 5.0  # the ellipsoid's height error is in it
    east, north, _ = smoother.calculateEstimateVector(variable_key("w", span))
    assert math.hypot(north - WIND_NED_MPS[0], east - WIND_NED_MPS[1]) < 3.0


def test_a_source_that_vanishes_and_comes_back_drops_and_adds_its_factors(rich):
    samples = [
        s
        for s in rich[0]
        if not (isinstance(s, VisionSample | BaroSample) and 5_000_000 < s.t_us < 8_000_000)
    ]
    states, _ = flown(samples)
    for source, back_us in (("baro", 8_000_000), ("vision", 8_400_000)):  # vision needs two
        times = used(states, source)
        assert not {t_us for t_us in times if 5_000_000 < t_us < back_us}
        assert max(times) == 10_000_000
        assert back_us in times
    assert not [state for state in states if "failed" in state.reason]


def test_a_jump_of_vision_gets_no_weight(rich):
    samples = [
        replace(s, r_ned_m=s.r_ned_m + JUMP_M)
        if isinstance(s, VisionSample) and s.t_us == JUMP_US
        else s
        for s in rich[0]
    ]
    states, _ = flown(samples)
    there_and_back = {JUMP_US, JUMP_US + 400_000}
    assert not used(states, "vision") & there_and_back
    reference, jumped = errors(rich[1], rich[0]), errors(states, rich[0])
    assert max(abs(jumped[t_us] - reference[t_us]) for t_us in jumped if t_us >= JUMP_US) < 0.05
    believing, _ = flown(samples, decide=False)
    assert used(believing, "vision") >= there_and_back


def test_late_samples_join_the_epoch_of_their_time(rich):
    late = [
        s
        for s in rich[0]
        if s.t_us == LATE_US
        and isinstance(s, BaroSample | MagSample | AirspeedSample | VisionSample)
    ]
    gone = {id(s) for s in late}
    samples = []
    for sample in rich[0]:
        if id(sample) not in gone:
            samples.append(sample)
        if isinstance(sample, Epoch) and sample.t_us == LATE_US + 400_000:
            samples += late
    _, graph = flown([s for s in samples if s.t_us <= 7_000_000])
    for source in ("baro", "mag", "airspeed", "vision"):
        times = {
            graph.epochs[epoch].t_us for name, epoch in graph.window.committed() if name == source
        }
        assert LATE_US in times
