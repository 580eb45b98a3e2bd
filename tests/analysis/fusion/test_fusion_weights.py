"""Decisions as weights."""

import itertools

import msgspec
import pytest

from analysis.fusion.factors.factor_weights import (
    faulty_rates,
    isolated_sensors,
    range_weights,
    residual_weight,
)
from analysis.fusion.fusion_config import FusionConfig
from analysis.monitor.pipeline import monitor_config
from analysis.results import Decision, SensorDecision
from mavproxy_fault.documents.errors import ConfigError

CONFIG = FusionConfig()


def decided(**changes: object) -> Decision:
    """A clean decision on three satellites, changed."""
    clean = Decision(
        t_us=1_000_000,
        statistic=3.0,
        threshold=20.0,
        dof=3,
        p_value=0.5,
        alarm=False,
        hypothesis="none",
        satellites=("G01", "G02", "G03"),
        normalised=(0.1, -1.0, 0.4),
    )
    return msgspec.structs.replace(clean, **changes)


def test_the_weight_falls_smoothly_from_one_to_zero_between_the_thresholds():
    values = [residual_weight(3.0 + 0.01 * k, 3.0, 6.0) for k in range(301)]
    assert values[0] == 1.0
    assert values[150] == pytest.approx(0.5)
    assert values[-1] == 0.0
    steps = [a - b for a, b in itertools.pairwise(values)]
    assert min(steps) > 0.0
    assert max(steps) < 0.0051  # the steepest slope of the cubic is 1.5 over the way


def test_the_sign_of_a_residual_does_not_matter():
    assert residual_weight(-4.0, 3.0, 6.0) == residual_weight(4.0, 3.0, 6.0) < 1.0


def test_a_suspicious_satellite_gets_less_weight_and_the_healthy_do_not():
    weights = range_weights(decided(normalised=(0.1, 4.5, -2.9)), CONFIG)
    assert weights == {"G01": 1.0, "G02": pytest.approx(0.5), "G03": 1.0}


def test_an_isolated_satellite_gets_no_weight_and_does_not_affect_the_others():
    said = decided(alarm=True, hypothesis="satellites", excluded=("G02",), normalised=(5.0, 9.0, 4))
    assert range_weights(said, CONFIG) == {"G01": 1.0, "G02": 0.0, "G03": 1.0}


def test_nothing_is_trusted_while_isolation_fails():
    said = decided(alarm=True, hypothesis="multiple-unknown")
    assert set(range_weights(said, CONFIG).values()) == {0.0}


def test_without_decisions_every_weight_is_one():
    said = decided(alarm=True, hypothesis="satellites", excluded=("G04",))
    weights = range_weights(said, FusionConfig(decide=False))
    assert weights == dict.fromkeys(("G01", "G02", "G03", "G04"), 1.0)


def test_isolated_and_alarmed_sensors_are_left_out():
    said = [
        SensorDecision(
            t_us=0, sensor=name, statistic=1, threshold=1, dof=1, alarm=alarm, isolated=out
        )
        for name, alarm, out in (("baro", True, False), ("mag", False, True), ("imu", False, False))
    ]
    assert isolated_sensors(said, CONFIG) == {"baro", "mag"}
    assert isolated_sensors(said, FusionConfig(decide=False)) == set()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lag_s": 0.0}, "monitor.fusion.lag_s = 0.0 is out of range"),
        ({"hopeless": 2.0}, "is not above suspicious"),
        ({"robust": "cauchy"}, "known: geman-mcclure, gnc, huber, none"),
        ({"lag": 5.0}, "monitor.fusion.lag is unknown"),
        ({"lag_s": "five"}, "expected `float`"),
    ],
)
def test_a_wrong_setting_is_refused_by_name(values, message):
    with pytest.raises(ConfigError, match=r"night\.yaml") as refused:
        monitor_config({"fusion": values}, "night.yaml")
    assert message in str(refused.value)


def test_fusion_is_off_by_default():
    assert monitor_config({}, "x").fusion is None
    assert monitor_config({"fusion": {}}, "x").fusion == FusionConfig()


def test_a_faulty_rate_excludes_only_its_own_satellite():
    def decided(sensor: str, suspect: str) -> SensorDecision:
        return SensorDecision(
            t_us=0, sensor=sensor, statistic=40.0, threshold=30.0, dof=8, alarm=True,
            isolated=True, suspect=suspect,
        )  # fmt: skip

    results = [
        decided("satellites", "G05"),
        decided("satellites", ""),
        decided("actuators", "motor 2"),
    ]
    assert faulty_rates(results) == {"G05"}
