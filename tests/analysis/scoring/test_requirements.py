"""Requirements: what they accept, and the robustness that they give, against rtamt."""

import contextlib
import re

import numpy as np
import pytest

from analysis.scoring.requirements import (
    TRUE,
    FlightSignals,
    Requirement,
    parse_requirements,
    read_requirements,
    ready_requirements,
)
from mavproxy_fault.documents.errors import ConfigError

STEP_S = 0.1
T_S = np.arange(300) * STEP_S


def flags(active):
    return np.where(active, TRUE, -TRUE)


def flight(start_s=0.0, fault_s=None, modes=None, **values):
    return FlightSignals(T_S, values, modes or ["GUIDED"] * len(T_S), start_s, fault_s)


def judge(formula, signals, **keys):
    return Requirement(formula=formula, **keys).judge(signals)


def test_a_violation_has_its_size_unit_and_time():
    height_m = np.where(T_S < 20.0, 30.0, 2.0)
    found = judge(
        "always(height_m > 5 or landing)", flight(height_m=height_m, landing=flags(T_S < 0))
    )
    assert (found.met, found.robustness, found.unit, found.at_s) == (False, -3.0, "m", 20.0)
    assert found.describe() == "violated by 3 m at 20.00 s"


def test_a_satisfied_requirement_has_its_smallest_margin():
    found = judge("always(tilt_deg < 60)", flight(tilt_deg=30.0 - abs(T_S - 12.0)))
    assert found.met
    assert found.robustness == pytest.approx(30.0)
    assert found.at_s == pytest.approx(12.0)


def test_true_and_false_alone_have_no_size():
    found = judge("always(not crashed)", flight(crashed=flags(T_S > 12.0)))
    assert (found.met, found.robustness, found.at_s) == (False, None, 12.1)
    assert found.fitness < -1e4
    assert judge("always(not crashed)", flight(crashed=flags(T_S < 0))).describe() == "satisfied"


def test_modes_are_compared_by_name_with_and_without_px4s_prefix():
    formula = "gps_lost -> eventually[0,10](mode in [AUTO.RTL, LAND])"
    lost = flags((T_S > 5.0) & (T_S < 6.0))
    for mode, met in (("RTL", True), ("LAND", True), ("GUIDED", False)):
        modes = ["GUIDED" if t < 12.0 else mode for t in T_S]
        assert judge(formula, flight(gps_lost=lost, modes=modes)).met is met
    for formula, met in (
        ("mode == GUIDED", True),
        ("mode not in [RTL]", True),
        ("mode != 'GUIDED'", False),
    ):
        assert judge(formula, flight()).met is met


def test_an_implication_and_a_comparison_are_meant_always():
    late = flags(T_S > 20.0)
    assert judge("fault -> tilt_deg < 5", flight(fault=late, tilt_deg=T_S)).at_s == 20.1
    assert judge("tilt_deg < 10", flight(tilt_deg=T_S)).at_s == 10.1


def test_other_formulas_count_from_the_first_fault():
    seen = flight(fault_s=10.0, detected=flags((T_S > 12.0) & (T_S < 13.0)))
    assert judge("eventually[0,3](detected)", seen).met
    assert judge("eventually[0,1](detected)", seen).met is False
    assert judge("eventually[0,1](detected)", seen, since="start").met is False
    assert (
        judge("eventually[0,3](detected)", flight(detected=flags(T_S > 50))).reason
        == "no fault acted"
    )


def test_a_deadline_after_the_end_of_the_flight_is_not_a_violation():
    lost = flags(T_S > 25.0)
    wanted = "gps_lost -> eventually[0,10](landed)"
    assert judge(wanted, flight(gps_lost=lost, landed=flags(T_S < 0))).met
    assert (
        judge("eventually[0,10](landed)", flight(fault_s=25.0, landed=flags(T_S < 0))).met is None
    )
    assert judge("eventually[0,10](landed)", flight(fault_s=25.0, landed=flags(T_S > 28))).met


def test_the_take_off_is_not_judged():
    height_m = np.minimum(T_S, 10.0)
    assert judge("always(height_m > 5)", flight(start_s=8.0, height_m=height_m)).met
    assert judge("always(height_m > 5)", flight(start_s=np.inf, height_m=height_m)).reason == (
        "the vehicle never took off"
    )


def test_a_signal_that_the_flight_lacks_gives_no_verdict():
    unknown = np.full(len(T_S), np.nan)
    assert (
        judge("always(speed_mps < 5)", flight(speed_mps=unknown)).reason
        == "the flight has no speed_mps"
    )
    assert "ekf.attitude" in judge("always(ekf.attitude_error_deg < 5)", flight()).reason


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("always(hight_m > 5)", "did you mean height_m"),
        ("always(height_m >> 5)", "write for example"),
        ("always(height_m > 5", "write for example"),
        ("(" * 2000, "shorten it"),
        ("", "write for example"),
        ("no_crush", "did you mean no_crash"),
    ],
)
def test_wrong_formulas_are_refused_with_the_cure(formula, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        read_requirements("--require", [formula])


def test_a_section_is_a_list_or_a_mapping():
    (one,) = parse_requirements({"upright": "always(tilt_deg < 60)"})
    assert (one.name, one.formula) == ("upright", "always(tilt_deg < 60)")
    assert parse_requirements({"x": {"formula": "landed", "since": "fault"}})[0].since == "fault"
    assert parse_requirements(["no_crash"])[0] == ready_requirements()["no_crash"]
    assert parse_requirements(None) == ()
    with pytest.raises(ValueError, match="occurs twice"):
        parse_requirements(["no_crash", "no_crash"])


def test_every_ready_requirement_can_be_judged_and_has_a_source():
    for one in ready_requirements().values():
        assert one.source
        assert one.signals


def test_the_robustness_equals_that_of_rtamt():
    rtamt = pytest.importorskip("rtamt", reason="rtamt needs Python below 3.13")
    rng = np.random.default_rng(7)
    values = {
        name: rng.normal(0, 2, len(T_S)).round(3) for name in ("height_m", "tilt_deg", "climb_mps")
    }
    values["landing"] = flags(rng.random(len(T_S)) < 0.2)
    signals = flight(fault_s=0.0, **values)
    atoms = ("(height_m > 1)", "(tilt_deg <= 0.5)", "(climb_mps - height_m >= 0)", "landing")

    def formula(depth):
        if depth == 0:
            return str(rng.choice(atoms))
        shape = rng.choice(["({} and {})", "({} or {})", "({} -> {})", "(not {})", "(always {})",
                            "(eventually{} {})", "(always{} {})", "({} until{} {})"])  # fmt: skip
        low, more = rng.integers(0, 5) * STEP_S, rng.integers(0, 40) * STEP_S
        bounds = f"[{low:.1f},{low + more:.1f}]"
        parts = [formula(depth - 1) for _ in range(shape.count("{}"))]
        if "until{}" in shape:
            parts[1] = bounds
        elif "ly{}" in shape or "s{}" in shape:
            parts[0] = bounds
        return shape.format(*parts)

    compared = 0
    for _ in range(200):
        text = formula(rng.integers(1, 4))
        one = Requirement(formula=text, since="start")
        spec = rtamt.StlDiscreteTimeOfflineSpecification()
        for name in values:
            spec.declare_var(name, "float")
        spec.set_sampling_period(100, "ms", 0.1)
        always = "Always" in one.tree and one.always is not None
        spec.spec = f"always({text})" if always else text
        spec.spec = spec.spec.replace("->", "implies")
        rows = {name: value.tolist() for name, value in values.items()}
        # It takes only multiples of its period, by floats.
        with contextlib.suppress(rtamt.RTAMTException):
            spec.parse()
            compare(one, signals, spec.evaluate({"time": T_S.tolist(), **rows})[0][1])
            compared += 1
    assert compared > 100


def compare(one, signals, expected):
    found = one.judge(signals)
    # Deadlines after the end are decided by rtamt, not here.
    if found.met is None or re.search(r"eventually\[|until\[", one.formula):
        return
    if found.robustness is None:
        assert found.met == (expected >= 1e5)
    else:
        assert found.robustness == pytest.approx(expected, abs=1e-9)
