"""Height, airspeed and position that inverted sensor models give on compiled flights."""

import msgspec
import numpy as np
import pytest

from analysis.search.evaluation.compiled_score import fly_estimated, inverted_rmse
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.space.test_file import (
    FaultRange,
    InitialState,
    Mission,
    SearchSensors,
    TestFile,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from simvehicle.environment.air import standard_air

SILENT = SearchSensors(
    pressure_sigma_pa=0.0, static_sigma_pa=0.0, position_kick_m=0.0, height_kick_m=0.0
)
LEVEL = TestFile(
    criterion="height", duration_s=10.0, noise_draws=1, mission=Mission(roll_deg=0.0),
    sensors=SILENT,
)  # fmt: skip


def rmse(test: TestFile, seed: int = 1) -> dict[str, float]:
    """RMSE of height, airspeed and position in one flight."""
    return inverted_rmse(fly_estimated(test, Evaluator(test).space.fixed, seed), test.density_kgpm3)


def with_fault(test: TestFile, target: str, value: float, fault: str = "bias") -> TestFile:
    """The test with a fault from the start on."""
    entry = FaultRange(fault=fault, target=target, value=value)
    return msgspec.structs.replace(test, faults=[entry])


def test_without_noise_the_inverted_models_are_right() -> None:
    found = rmse(LEVEL)
    # The air is that of the height, the model's that of the start.
    assert found == pytest.approx(
        {"height_m": 0.0, "airspeed_mps": 0.0, "position_m": 0.0}, abs=0.01
    )


def test_a_wrong_pressure_is_a_wrong_height() -> None:
    _, _, density = standard_air(0.0)
    found = rmse(with_fault(LEVEL, "HIL_SENSOR.abs_pressure", 1.0))  # hPa
    assert found["height_m"] == pytest.approx(100.0 / (density * STANDARD_GRAVITY_MPS2), rel=0.01)


def test_pressure_drifts_with_the_temperature() -> None:
    # Thin air: the flight is at the height where the standard atmosphere is that dense.
    high = msgspec.structs.replace(
        LEVEL,
        density_kgpm3=1.1117,  # at 1000 m
        initial=InitialState(height_m=100.0),
        sensors=msgspec.structs.replace(SILENT, static_drift_pa_per_k=5.0),
    )
    _, kelvin, density = standard_air(1000.0)
    expected_pa = 5.0 * (288.15 - kelvin)
    assert rmse(high)["height_m"] == pytest.approx(
        expected_pa / (density * STANDARD_GRAVITY_MPS2), rel=0.02
    )


def test_the_gps_position_wanders_as_its_process_says() -> None:
    test = msgspec.structs.replace(
        LEVEL,
        criterion="position",
        sensors=msgspec.structs.replace(SILENT, position_kick_m=0.21, height_kick_m=0.40),
        position_k_per_s=1.0 / 1100.0,
        noise_draws=1,
    )
    phi = np.exp(-1.0 / 1100.0 / 5.0)
    sigma = np.sqrt((2.0 * 0.21**2 + 0.40**2) / (1.0 - phi**2))  # at 5 Hz
    each = [rmse(test, seed)["position_m"] for seed in range(24)]
    # Three axes of one number each, as good as constant in ten seconds.
    assert np.sqrt(np.mean(np.square(each))) == pytest.approx(sigma, rel=0.35)


@pytest.mark.parametrize(
    ("target", "value", "metres"),
    [
        ("HIL_GPS.lat", 1000.0, 11.114),
        ("HIL_GPS.lon", 1000.0, 7.815),
        ("HIL_GPS.alt", 2500.0, 2.5),
    ],
)
def test_a_wrong_latitude_is_metres(target: str, value: float, metres: float) -> None:
    found = rmse(with_fault(msgspec.structs.replace(LEVEL, criterion="position"), target, value))
    assert found["position_m"] == pytest.approx(metres, rel=1e-3)


def test_a_lost_position_is_not_scored() -> None:
    test = msgspec.structs.replace(
        LEVEL,
        criterion="position",
        faults=[
            FaultRange(fault="bias", target="HIL_GPS.lat", value=1e4, at_s=5.0),
            FaultRange(fault="drop", target="HIL_GPS", at_s=5.0),
        ],
    )
    assert rmse(test)["position_m"] == pytest.approx(0.0, abs=1e-6)


def test_a_blocked_pitot_tube_is_a_wrong_airspeed() -> None:
    test = msgspec.structs.replace(LEVEL, criterion="airspeed")
    blocked = with_fault(test, "HIL_SENSOR.diff_pressure", 0.0, "constant")
    # All of it is missing.
    assert rmse(blocked)["airspeed_mps"] == pytest.approx(35.0, abs=0.5)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"estimator": "ekf"}, "criterion: height needs all twelve states"),
        ({"vehicle": "iris", "criterion": "airspeed"}, "needs a pitot tube"),
        ({"scenario": {}}, "criterion: height needs estimator inverse-model without"),
    ],
)
def test_criteria_that_the_kernels_cannot_evaluate_are_refused(
    changes: dict[str, object], error: str
) -> None:
    with pytest.raises((ValueError, ConfigError), match=error):
        msgspec.structs.replace(LEVEL, **changes)
