"""Actuators that do not respond, in flights of the simulator through proxy and monitor."""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from analysis.detection.actuators.actuator_detector import ActuatorDetector, initial_response
from analysis.detection.actuators.actuator_hypotheses import NO_HYPOTHESIS, ActuatorHypothesis
from analysis.detection.actuators.alarm_precedence import CRASHED
from analysis.detection.actuators.effects import FORWARD, OUTPUT, TERMS, THROTTLE
from analysis.detection.actuators.motion_filter import initial_motion_model
from analysis.detection.actuators.response_regression import NO_HYPOTHESES
from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.results import Decision, Result, SensorDecision
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import RunSetup, read_setup
from analysis.run.vehicle_effects import vehicle_effects
from analysis.samples.block import COMMAND, Block, block_of
from analysis.samples.decoder import Decoder
from analysis.samples.sample import CommandSample, GpsFix, ImuSample
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.rigidbody_kernel import P
from simvehicle.vehicles.vehicle import SURROUNDINGS_SIZE, pack_surroundings

HOVER = str(Path(__file__).parents[4] / "examples" / "hover.yaml")
IMU_HZ = 100.0
# A fault that never acts: commands go over the wire all the same.
NEVER = {
    "fault": "constant",
    "value": 1.0,
    "target": "HIL_ACTUATOR_CONTROLS.controls[2]",  # of a wing and of a quad
    "at_s": 1e4,
}
START_US = 1_000_000  # the vehicle's clock at the start of the flight
ONSET_S = 10.0  # of a fault, unless a test says otherwise
LEARNT_S = 20.0  # when effects have been learnt in flight


@functools.cache
def setup_of(vehicle: str) -> RunSetup:
    """The demo's fixed wing, or a multirotor, in gusts and with a receiver that is quick to fly."""
    setup = read_setup(None if vehicle == "fixed wing" else HOVER)
    hover = read_setup(HOVER).scenario
    scenario = setup.scenario
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=IMU_HZ)
    scenario = msgspec.structs.replace(
        scenario,
        gnss=None,
        sensors=msgspec.structs.replace(scenario.sensors, imu=imu, gps=hover.sensors.gps),
        environment=msgspec.structs.replace(scenario.environment, gusts="moderate"),
    )
    monitor = setup.monitor
    if vehicle == "hexa":
        parameters = msgspec.structs.replace(scenario.vehicle, parameters="hexa")
        scenario = msgspec.structs.replace(scenario, vehicle=parameters)
        monitor = msgspec.structs.replace(monitor, actuators=vehicle_effects(scenario))
    return RunSetup(scenario, setup.schedule, monitor, setup.criteria)


def flown(
    vehicle: str, duration_s: float, *faults: dict[str, Any], seed: int = 1, unknown: bool = False
) -> list[Result]:
    """The monitor's results of a flight with faults; it may not know the vehicle."""
    config = MonitorConfig() if unknown else setup_of(vehicle).monitor
    return Monitor(config).push_bytes(
        [sent(vehicle, duration_s, *faults, seed=seed)], datagrams=False
    )


def sent(vehicle: str, duration_s: float, *faults: dict[str, Any], seed: int = 1) -> bytes:
    """What the monitor hears of such a flight."""
    return _fly(vehicle, duration_s, json.dumps(faults), seed)


@functools.cache
def _fly(vehicle: str, duration_s: float, faults: str, seed: int) -> bytes:
    """Fly once for all tests that watch the same flight."""
    setup = setup_of(vehicle)
    scenario = msgspec.structs.replace(setup.scenario, seed=seed, duration_s=duration_s)
    entries = [
        {"id": f"fault-{i}", "at_s": ONSET_S, **fault} for i, fault in enumerate(json.loads(faults))
    ]
    flight = ProxiedFlight(
        scenario, parse_schedule({"seed": seed, "faults": entries}, via="simulator")
    )
    data = bytearray()
    while not flight.finished:
        data += flight.advance([]).monitor
    return bytes(data)


def named(results: list[Result]) -> dict[str, float]:
    """The isolated actuators, and when each was first, in seconds of the flight."""
    found: dict[str, float] = {}
    for result in results:
        if isinstance(result, SensorDecision) and result.sensor == "actuators" and result.isolated:
            found.setdefault(result.suspect, (result.t_us - START_US) * 1e-6)
    return found


def suspected(results: list[Result]) -> set[str]:
    """Of whom it was said that they may be at fault, one alone or two."""
    reported = (r for r in results if isinstance(r, SensorDecision) and r.sensor == "actuators")
    return {result.suspect for result in reported if result.alarm}


@pytest.mark.parametrize(
    ("vehicle", "target", "value", "name"),
    [
        ("quad", "PLANT.motor_efficiency[1]", 0.8, "motor 2"),
        ("quad", "PLANT.motor_efficiency[2]", 0.0, "motor 3"),
        ("hexa", "PLANT.motor_efficiency[4]", 0.8, "motor 5"),
        ("hexa", "PLANT.motor_efficiency[0]", 0.0, "motor 1"),
        ("fixed wing", "PLANT.motor_efficiency[0]", 0.0, "throttle"),
        ("fixed wing", "PLANT.motor_efficiency[0]", 0.8, "throttle"),
    ],
)
def test_a_weak_actuator_is_named(vehicle: str, target: str, value: float, name: str) -> None:
    found = named(flown(vehicle, 13.0, {"fault": "plant", "target": target, "value": value}))
    assert list(found) == [name]
    assert ONSET_S < found[name] < ONSET_S + 2.5


def test_half_an_elevator_is_separable_from_a_shifting_load() -> None:
    """By how it answers its moves: a load would not change that."""
    fault = {"fault": "plant", "target": "PLANT.elevator_efficiency", "value": 0.5}
    fault["at_s"] = LEARNT_S
    assert list(named(flown("fixed wing", 25.0, fault))) == ["elevator"]


@pytest.mark.parametrize(
    ("vehicle", "until_s", "fault", "name"),
    [
        (
            "fixed wing",
            64.0,
            {"fault": "plant", "target": "PLANT.elevator_efficiency", "value": 0.8},
            "elevator",
        ),
        (
            "fixed wing",
            86.0,
            {"fault": "freeze", "target": "HIL_ACTUATOR_CONTROLS.controls[2]"},
            "rudder",
        ),
        (
            "hexa",
            76.0,
            {"fault": "freeze", "target": "HIL_ACTUATOR_CONTROLS.controls[1]"},
            "motor 2",
        ),
    ],
)
def test_a_fault_hidden_by_gusts_is_found_by_the_regression(
    vehicle: str, until_s: float, fault: dict[str, Any], name: str
) -> None:
    """A fifth of the elevator, and what is stuck where it is."""
    found = named(flown(vehicle, until_s, {**fault, "at_s": 60.0}))
    assert list(found) == [name]
    assert found[name] > 60.0


@pytest.mark.parametrize(
    "fault",
    [
        {"fault": "bias", "value": 1.0},
        {"fault": "bias", "value": -1.0},
        {"fault": "scale", "value": 1.3},
        {"fault": "drift", "value": 0.05},
        {"fault": "constant", "value": 0.0},
    ],
    ids=str,
)
def test_a_faulty_pitot_tube_is_no_weak_motor(fault: dict[str, Any]) -> None:
    fault = {"target": "HIL_SENSOR.diff_pressure", "at_s": LEARNT_S, **fault}
    assert not suspected(flown("fixed wing", 34.0, fault, NEVER))


def test_a_wing_at_an_unusual_speed_has_no_strong_motor() -> None:
    """In 28 m/s of air after 24.5: a propeller pulls less there, by more than was learnt."""
    assert not suspected(flown("fixed wing", 30.0, NEVER, seed=107))


def test_a_wings_throttle_counts_what_it_pulls() -> None:
    """From the glide slope to the flare at 21 m/s, where a linear throttle would pull twice as
    much less, and turn the wing as much more."""
    scenario = setup_of("fixed wing").scenario
    effects, plane = vehicle_effects(scenario), FixedWing.read(scenario.vehicle.parameters)
    model, motions = initial_motion_model(effects), []
    for throttle in (0.62, 0.0):
        wind, gravity = np.zeros(3), np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
        around = pack_surroundings(wind, gravity, 1.225, 1e4, np.empty(SURROUNDINGS_SIZE))
        start = plane.cruise(wind, 0.0, wind, 21.0, 1.225, STANDARD_GRAVITY_MPS2)
        state, load = plane.advance(start, np.array([0.0, 0.0, 0.0, throttle]), around, 1, 0.005)
        terms = np.zeros(TERMS)
        terms[OUTPUT + effects.names.index(THROTTLE)] = throttle
        predicted = (model.theta * model.scale_terms(terms)).sum(axis=1)
        motions.append(((state[P] - start[P]) / 0.005, load[0], *predicted[[0, FORWARD]]))
    roll, pull, predicted_roll, predicted_pull = np.subtract(*motions)
    assert predicted_pull == pytest.approx(pull, rel=0.15)
    assert predicted_roll == pytest.approx(roll, rel=0.25)


@pytest.mark.parametrize("preset", ["load-shift", "link-poor"])
def test_sensor_faults_isolate_no_actuator(preset: str) -> None:
    assert not named(flown("fixed wing", 22.0, {"preset": preset, "for_s": 10.0}, NEVER))


@pytest.mark.parametrize(
    ("target", "fault", "name"),
    [
        ("controls[7]", {"fault": "freeze"}, "elevator"),
        ("controls[7]", {"fault": "constant", "value": 1.0}, "elevator"),
        ("controls[2]", {"fault": "constant", "value": 1.0}, "rudder"),
        ("controls[6]", {"fault": "constant", "value": 1.0}, "aileron"),
    ],
)
def test_a_stuck_or_hard_over_surface_is_named(
    target: str, fault: dict[str, Any], name: str
) -> None:
    fault = {"target": f"HIL_ACTUATOR_CONTROLS.{target}", **fault}
    found = named(flown("fixed wing", 14.0, fault))
    assert list(found) == [name]


@pytest.mark.parametrize("value", [0.0, 0.8])
def test_a_weak_motor_of_an_unknown_quad_is_named_by_its_learned_effect(value: float) -> None:
    fault = {"fault": "plant", "target": "PLANT.motor_efficiency[2]", "value": value}
    fault["at_s"] = LEARNT_S
    assert list(named(flown("quad", 23.0, fault, unknown=True))) == ["motor 3"]


@pytest.mark.parametrize("vehicle", ["hexa", "fixed wing"])
def test_an_unknown_vehicle_whose_effects_are_not_observable_is_not_tested(vehicle: str) -> None:
    results = flown(vehicle, 30.0, NEVER, unknown=True)
    assert not [r for r in results if isinstance(r, SensorDecision) and r.sensor == "actuators"]


def test_sparse_commands_do_not_determine_the_motion_of_an_unknown_quad() -> None:
    fault = {"fault": "plant", "target": "PLANT.motor_efficiency[2]", "value": 0.8}
    fault["at_s"] = LEARNT_S
    frames = Parser().push(sent("quad", 23.0, fault), datagram=False)
    block = Decoder().decode(frame for frame in frames if isinstance(frame, Frame))
    commands = block.rows(COMMAND)
    apart_us = float(np.median(np.diff(block.t_us[commands])))
    keep = np.ones(len(block.kind), bool)
    keep[commands] = np.arange(len(commands)) % round(100_000 / apart_us) == 0
    for heard, names in ((block, ["motor 3"]), (block.where(keep), [])):
        assert list(named(Monitor(MonitorConfig()).push(heard))) == names


def test_gusts_isolate_no_motor_of_an_unknown_quad() -> None:
    results = flown("quad", 40.0, NEVER, seed=7, unknown=True)
    reported = [r for r in results if isinstance(r, SensorDecision) and r.sensor == "actuators"]
    assert len(reported) > 20
    assert not any(result.alarm for result in reported)


@pytest.mark.parametrize("vehicle", ["quad", "hexa", "fixed wing"])
def test_gusts_isolate_no_actuator(vehicle: str) -> None:
    results = flown(vehicle, 40.0, NEVER, seed=7)
    reported = [r for r in results if isinstance(r, SensorDecision) and r.sensor == "actuators"]
    assert len(reported) > 30  # one a second
    assert not any(result.alarm for result in reported)


def test_a_gyro_that_is_nan_isolates_no_actuator() -> None:
    fault = {"fault": "not-a-number", "target": "HIL_SENSOR.xgyro", "for_s": 3.0}
    assert not named(flown("quad", 16.0, fault, NEVER))


def test_a_gap_of_the_imu_isolates_no_actuator() -> None:
    outage = {"preset": "communication-interrupted", "for_s": 10.0}
    assert not named(flown("quad", 24.0, outage, NEVER))


def test_after_a_crash_no_sensor_is_isolated() -> None:
    results = flown(
        "quad", 18.0, {"fault": "plant", "target": "PLANT.motor_efficiency[0]", "value": 0.0}
    )
    assert list(named(results)) == ["motor 1"]
    judged = [r for r in results if isinstance(r, Decision | SensorDecision)]
    others = [r for r in judged if getattr(r, "sensor", "") != "actuators"]
    assert any(result.reason == CRASHED for result in others)
    assert not any(result.alarm for result in others)


def test_the_cut_into_blocks_changes_nothing() -> None:
    """Rows one by one, and all at once."""
    effects = setup_of("quad").monitor.actuators
    assert effects is not None
    detector, rng = ActuatorDetector(effects), np.random.default_rng(3)
    samples: list[Any] = []
    for k in range(600):
        t_us = 10_000 * k
        samples.append(CommandSample(t_us, np.full(12, 0.7)))
        samples.append(ImuSample(t_us, 0.01 * rng.normal(size=3), np.array([0.0, 0.0, -9.8])))
    whole = _flying(block_of(samples))
    at_once, _ = detector.step(whole, detector.new_state())
    state, one_by_one = detector.new_state(), []
    for row in range(len(whole.kind)):
        found, state = detector.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert [result for _, result in at_once] == one_by_one
    assert len(one_by_one) == 5


@pytest.mark.parametrize(
    ("alt_m", "blow_mps2", "judged"),
    [(502.0, 0.0, False), (510.0, 0.0, True), (510.0, 200.0, False)],
)
def test_what_touches_the_ground_or_hits_it_isolates_no_actuator(
    alt_m: float, blow_mps2: float, judged: bool
) -> None:
    """A motor's command falls without a response: 2 and 10 m above the first fix."""
    effects = setup_of("quad").monitor.actuators
    assert effects is not None
    detector, rng = ActuatorDetector(effects), np.random.default_rng(3)
    fix = GpsFix(0, 47.0, 8.0, 500.0, np.array([0.0, 0.0, 2.0]), 3, 12, 1.0, 1.0, "HIL_GPS")
    samples: list[Any] = [CommandSample(0, np.full(12, 0.7)), fix]
    for k in range(900):
        t_us, commands = 10_000 * k, np.full(12, 0.7)
        commands[0] -= 0.2 * (k > 700)
        if k % 20 == 0:
            samples.append(dataclasses.replace(fix, t_us=t_us, alt_m=alt_m if k > 600 else 510.0))
        samples.append(CommandSample(t_us, commands))
        force = np.array([0.0, 0.0, -9.8 - blow_mps2 * (k == 700)])
        samples.append(ImuSample(t_us, 0.01 * rng.normal(size=3), force))
    found, _ = detector.step(block_of(samples), detector.new_state())
    alarms = [r for _, r in found if isinstance(r, SensorDecision) and r.alarm]
    assert bool(alarms) == judged


@pytest.mark.parametrize(("began_mps", "judged"), [(0.0, False), (12.0, True)])
def test_after_a_landing_the_wheels_hide_the_effect_of_surfaces(
    began_mps: float, judged: bool
) -> None:
    """An elevator's command rises without a response, 2 m above the first fix; a plane
    that began in flight may fly there."""
    effects = setup_of("fixed wing").monitor.actuators
    assert effects is not None
    detector, rng = ActuatorDetector(effects), np.random.default_rng(3)
    fix = GpsFix(0, 47.0, 8.0, 500.0, np.array([began_mps, 0.0, 0.0]), 3, 12, 1.0, 1.0, "HIL_GPS")
    samples: list[Any] = [CommandSample(0, np.zeros(12)), fix]
    rolling = np.array([12.0, 0.0, 0.0])
    for k in range(900):
        t_us, commands = 10_000 * k, np.zeros(12)
        commands[6:8] = 0.5 * (k > 700)
        if k % 20 == 0:
            alt_m = 502.0 if k > 600 else 510.0
            samples.append(dataclasses.replace(fix, t_us=t_us, alt_m=alt_m, v_ned_mps=rolling))
        samples.append(CommandSample(t_us, commands))
        samples.append(ImuSample(t_us, 0.01 * rng.normal(size=3), np.array([0.0, 0.0, -9.8])))
    found, _ = detector.step(block_of(samples), detector.new_state())
    alarms = [r for _, r in found if isinstance(r, SensorDecision) and r.alarm]
    assert bool(alarms) == judged


def _flying(block: Block) -> Block:
    """The block with fixes of a vehicle that moves, before and after its first command."""
    fix = GpsFix(0, 47.0, 8.0, 500.0, np.array([5.0, 0.0, 0.0]), 3, 12, 1.0, 1.0, "HIL_GPS")
    command, *others = block.samples()
    return block_of([fix, command, fix, *others])


def test_without_commands_nothing_is_done() -> None:
    effects = setup_of("quad").monitor.actuators
    assert effects is not None
    detector = ActuatorDetector(effects)
    sample = ImuSample(1, np.zeros(3), np.zeros(3))
    assert detector.step(block_of(sample), detector.new_state()) == ([], None)


@pytest.mark.parametrize("absurd", [1e200, -3e38, np.inf])
def test_impossible_values_are_ignored(absurd: float) -> None:
    """As a damaged log has them."""
    effects = setup_of("quad").monitor.actuators
    assert effects is not None
    detector, rng = ActuatorDetector(effects), np.random.default_rng(3)
    samples: list[Any] = []
    for k in range(600):
        t_us, commands, force = 10_000 * k, np.full(12, 0.7), np.array([0.0, 0.0, -9.8])
        if k == 400:
            commands[1] = force[1] = absurd
        samples.append(CommandSample(t_us, commands))
        samples.append(ImuSample(t_us, 0.01 * rng.normal(size=3), force))
    found, _ = detector.step(_flying(block_of(samples)), detector.new_state())
    assert len(found) == 5
    assert not any(result.alarm for _, result in found)


def test_the_end_of_a_fault_is_no_evidence_of_another() -> None:
    """Residual and command drop together as a motor recovers, which is what a total loss does."""
    response = initial_response(setup_of("quad").monitor.actuators)
    regression = response.regression
    response.isolated = (NO_HYPOTHESIS, 0)
    regression.own[0], regression.shared[0], regression.weight = 8e4, 7.9e4, 18.0
    response._update_isolation(ActuatorHypothesis(statistic=1.0))
    assert response.isolated == NO_HYPOTHESES
    assert regression.weight == 0.0
    assert not regression.shared.any()


@pytest.mark.parametrize("vehicle", ["quad", "hexa", "fixed wing"])
def test_no_actuator_leads_its_command(vehicle: str) -> None:
    """A lag of -3e-17 s, which is rounding, made every test of a fixed wing NaN."""
    effects = setup_of(vehicle).monitor.actuators
    assert (effects.lags_s >= 0.0).all()


@pytest.mark.parametrize(("first", "suspended"), [(0.0, True), (0.5, False)])
def test_near_the_ground_that_it_took_off_from_a_vehicle_may_touch_it_at_any_speed(
    first: float, suspended: bool
) -> None:
    state = initial_response(setup_of("quad").monitor.actuators)
    commands = CommandSample(0, np.full(12, first), "HIL_ACTUATOR_CONTROLS")
    drifting = np.array([5.0, 0.0, 0.7])
    fixes = [
        GpsFix(t, 47.0, 8.0, alt_m, drifting, 3, 12, 1.0, 1.0, "HIL_GPS")
        for t, alt_m in enumerate([500.0, 510.0, 501.0], 1)
    ]
    assert list(state.add_block(block_of([commands, *fixes]))) == []
    assert (state.irregular_left > 0) == suspended
