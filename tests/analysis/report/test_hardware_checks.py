"""Checks of motors, redundant sensors, cells, and the end of a flight."""

import numpy as np
import pytest

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.curves.recording import FlightData, GroundTrack, Signal, Span, Vector
from analysis.report.flight_checks import flight_checks
from analysis.report.flight_checks.level_checks import compare_motors
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FlightCheck

T_S = np.arange(0.0, 60.0, 0.05)
NONE = np.zeros_like(T_S)


def checks(*signals: Signal, armed: tuple[float, float] = (2.0, 60.0), **more: object) -> dict:
    span = Span("armed", *armed, "armed", "mode")
    recording = FlightData("x", duration_s=60.0, signals=list(signals), spans=[span], **more)
    return {check.name: check for check in flight_checks(recording, Thresholds())}


def verdict(found: dict[str, FlightCheck], name: str) -> str:
    return found[name].verdict


def motors(last: Vector) -> list[Signal]:
    level = np.full_like(T_S, 0.5)
    outputs = (level, level, level, last)
    return [Signal("actuators", f"motor {i + 1}", T_S, v) for i, v in enumerate(outputs)]


def test_a_motor_with_a_higher_command_fails_the_balance_check() -> None:
    assert verdict(checks(*motors(np.full_like(T_S, 0.55))), "motor balance") == "PASS"
    found = checks(*motors(np.where(T_S > 30, 0.95, 0.5)))
    assert verdict(found, "motor balance") == "FAIL"
    assert "motor 4" in found["motor balance"].evidence


def test_a_motor_that_works_harder_than_in_a_reference_flight_is_named() -> None:
    flights = [FlightData("x", signals=motors(np.full_like(T_S, x))) for x in (0.5, 0.52, 0.61)]
    good, usual, weak = map(add_derived_curves, flights)
    assert compare_motors(usual, [good], Thresholds()).verdict == "PASS"
    found = compare_motors(weak, [good, usual], Thresholds())
    assert found.verdict == "WARN"
    assert found.evidence == "motor 4 at +7.5 % of its range, the others at most -2.5 %"
    surfaces = add_derived_curves(FlightData("x", signals=motors(np.sin(T_S))))
    assert compare_motors(weak, [surfaces], Thresholds()).verdict == "not judged"


def test_a_motor_at_its_limit_fails_once_it_stays_there() -> None:
    brief = np.where((T_S > 30) & (T_S < 30.5), 1.0, 0.5)
    assert verdict(checks(*motors(brief)), "motors at their limit") == "PASS"
    long = np.where(T_S > 30, 1.0, 0.5)
    assert verdict(checks(*motors(long)), "motors at their limit") == "FAIL"


def test_surfaces_are_no_motors() -> None:
    assert verdict(checks(*motors(np.sin(T_S))), "motor balance") == "not judged"


def test_ardupilots_outputs_are_motors_by_their_function() -> None:
    outputs = [Signal("outputs", f"output {i}", T_S, np.full_like(T_S, 1500.0)) for i in (1, 2, 3)]
    outputs.append(Signal("outputs", "output 4", T_S, np.full_like(T_S, 2000.0)))
    functions = {f"SERVO{i}_FUNCTION": [(0.0, 32.0 + i)] for i in (1, 2, 3, 4)}
    found = checks(*outputs, parameters=functions)
    assert verdict(found, "motors at their limit") == "FAIL"
    assert verdict(checks(*outputs), "motors at their limit") == "not judged"


@pytest.mark.parametrize(
    ("panel", "value", "name"),
    [
        ("gyro-disagreement", 0.3, "gyroscopes agree"),
        ("accel-disagreement", 5.0, "accelerometers agree"),
        ("divergence", 20.0, "estimators agree"),
    ],
)
def test_redundant_sensors_that_disagree_fail(panel: str, value: float, name: str) -> None:
    assert verdict(checks(Signal(panel, "x", T_S, NONE)), name) == "PASS"
    apart = np.where(T_S > 30, value, 0.0)
    assert verdict(checks(Signal(panel, "x", T_S, apart)), name) == "FAIL"


def test_long_loops_fail_but_not_those_of_a_simulated_processor() -> None:
    loops = Signal("scheduler", "long loops", T_S, np.full_like(T_S, 12.0))
    assert verdict(checks(loops), "scheduler") == "FAIL"
    # On a nominal Pixhawk every twentieth loop is long.
    often = Signal("scheduler", "long loops", T_S, np.full_like(T_S, 5.0))
    assert verdict(checks(often), "scheduler") == "PASS"
    simulated = {"SIM_SPEEDUP": [(0.0, 1.0)]}
    assert verdict(checks(loops, parameters=simulated), "scheduler") == "not judged"


def test_an_empty_cell_fails_and_an_unconnected_one_does_not() -> None:
    flat = Signal("battery-cells", "cell 3", T_S, np.where(T_S > 40, 3.1, 3.9))
    absent = Signal("battery-cells", "cell 4", T_S, NONE)
    assert verdict(checks(flat, absent), "cell voltage") == "FAIL"
    assert verdict(checks(absent), "cell voltage") == "not judged"


def fall(speed_mps: float) -> list[Signal]:
    """A climb to 30 m and a fall to the ground."""
    height = np.clip(np.minimum(2 * T_S, 30 - speed_mps * (T_S - 30)), 0.0, 30.0)
    climb = np.gradient(height, T_S)
    return [Signal("height", "estimate", T_S, height), Signal("climb", "estimate", T_S, climb)]


@pytest.mark.parametrize(("speed_mps", "word"), [(1.0, "PASS"), (2.5, "WARN"), (8.0, "FAIL")])
def test_an_impact_is_judged_by_its_speed(speed_mps: float, word: str) -> None:
    found = checks(*fall(speed_mps))
    assert verdict(found, "ground impact") == word
    assert verdict(found, "landing before the log ends") == "PASS"


def test_a_brisk_descent_that_is_braked_in_the_air_is_no_impact() -> None:
    height = np.interp(T_S, [0, 20, 30, 35, 45, 60], [0, 40, 40, 15, 15, 0.0])
    climb = np.gradient(height, T_S)
    signals = [Signal("height", "estimate", T_S, height), Signal("climb", "estimate", T_S, climb)]
    assert verdict(checks(*signals), "ground impact") == "PASS"


def test_a_log_that_ends_in_the_air_warns_and_one_that_ends_falling_fails() -> None:
    aloft = Signal("height", "estimate", T_S, np.minimum(2 * T_S, 30.0))
    assert verdict(checks(aloft), "landing before the log ends") == "WARN"
    falling = Signal("height", "estimate", T_S, np.where(T_S > 57, 60 - 8 * (T_S - 57), 60.0))
    assert verdict(checks(falling), "landing before the log ends") == "FAIL"
    assert verdict(checks(aloft, armed=(2.0, 50.0)), "landing before the log ends") == "PASS"


@pytest.mark.parametrize(
    ("thrust", "force_mps2", "word"), [(0.0, 9.8, "PASS"), (50.0, 9.8, "WARN"), (0.0, 0.1, "WARN")]
)
def test_without_thrust_and_without_a_fall_a_height_that_drifts_is_no_flight(
    thrust: float, force_mps2: float, word: str
) -> None:
    still = [Signal("accel", axis, T_S, NONE) for axis in "xy"]
    still.append(Signal("accel", "z", T_S, np.full_like(T_S, -force_mps2)))
    drift = Signal("height", "estimate", T_S, np.minimum(2 * T_S, 30.0))
    idle = Signal("throttle", "throttle", T_S, np.where(T_S > 55.0, thrust, 50.0))
    assert verdict(checks(drift, idle, *still), "landing before the log ends") == word


@pytest.mark.parametrize(
    ("before", "after", "word"),
    [(0.0, 2.0, "PASS"), (0.0, 178.0, "FAIL"), (0.0, 85.0, "FAIL"), (90.0, 90.0, "PASS")],
)
def test_an_overturned_vehicle_fails_and_an_upright_tail_sitter_passes(
    before: float, after: float, word: str
) -> None:
    # Inverted flight in between is not a failure.
    tilt = np.where(T_S < 10, before, np.where(T_S < 55, 180.0, after))
    signal = Signal("tilt", "ATTITUDE", T_S, tilt)
    for end_s in (57.0, 60.0):  # disarmed, or the log is cut off armed
        assert verdict(checks(signal, armed=(2.0, end_s)), "vehicle ends upright") == word
    assert verdict(checks(), "vehicle ends upright") == "not judged"


@pytest.mark.parametrize(("tilt_deg", "word"), [(40.0, "PASS"), (120.0, "FAIL")])
def test_a_vehicle_that_is_thrown_over_fails_however_well_it_lands(
    tilt_deg: float, word: str
) -> None:
    tilt = np.where((T_S > 20.0) & (T_S < 21.0), tilt_deg, 3.0)
    found = checks(*fall(1.0), Signal("tilt", "ATTITUDE", T_S, tilt))
    assert verdict(found, "control in flight") == word


def test_a_wrong_height_fails_at_the_right_horizontal_position() -> None:
    place = np.full_like(T_S, 47.0), np.full_like(T_S, 8.0)
    truth = GroundTrack("truth", T_S, *place, np.full_like(T_S, 500.0))
    own = GroundTrack("estimate", T_S, *place, np.where(T_S > 30, 533.7, 500.0))
    found = checks(tracks=[truth, own])
    assert verdict(found, "height against the truth") == "FAIL"


def test_a_corrupted_file_weakens_the_verdict() -> None:
    note = "parts of the file are corrupted and were skipped"
    assert verdict(checks(notes=[note]), "log is complete") == "WARN"


def test_a_problem_until_arming_warns_and_one_that_ended_before_does_not() -> None:
    late = Signal("gps-fix", "GPS", T_S, np.where(T_S < 11, 0.0, 3.0))
    early = Signal("gps-fix", "GPS", T_S, np.where(T_S < 5, 0.0, 3.0))
    assert verdict(checks(late, armed=(10.5, 60.0)), "before arming") == "WARN"
    assert verdict(checks(early, armed=(10.5, 60.0)), "before arming") == "PASS"


@pytest.mark.parametrize(
    ("starts_s", "expected"),
    [
        ([], "not judged"),
        ([0.0, 12.0, 30.0, 60.0], "PASS"),
        ([0.0, 12.0, 15.0, 21.0], "WARN"),
        ([0.0, 70.0, 71.0, 72.0], "PASS"),  # disarmed
        ([0.0, *np.arange(20.0, 28.0)], "FAIL"),
    ],
)
def test_frequent_estimator_switches_fail(starts_s: list[float], expected: str) -> None:
    ends_s = [*starts_s[1:], 90.0]
    spans = [Span("armed", 1.0, 65.0, "armed", "mode")]
    spans += [
        Span("estimator in use", begin, end, f"instance {i % 2 + 1}", "mode")
        for i, (begin, end) in enumerate(zip(starts_s, ends_s, strict=False))
    ]
    recording = FlightData("a", spans=spans, duration_s=90.0)
    found = {check.name: check for check in flight_checks(recording, Thresholds())}
    assert found["estimator switches"].verdict == expected


def test_an_unpowered_servo_rail_is_not_a_brown_out() -> None:
    board = Signal("board-voltage", "Vcc", T_S, np.full_like(T_S, 5.0))
    nothing = Signal("board-voltage", "servo rail", T_S, np.where(T_S > 30, 0.12, 0.0))
    assert verdict(checks(board, nothing), "board voltage") == "PASS"
    gone = Signal("board-voltage", "servo rail", T_S, np.where(T_S > 30, 0.1, 5.1))
    assert verdict(checks(board, gone), "board voltage") == "FAIL"
