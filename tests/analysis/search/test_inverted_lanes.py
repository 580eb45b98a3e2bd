"""Height, airspeed and position that the kernels' inverted sensor models give."""

import msgspec
import numpy as np
import pytest

from analysis.search.evaluation.compiled_batch import Batch
from analysis.search.lanes.inverted_lanes import AIRSPEED, HEIGHT, POSITION
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


def rmse(test: TestFile, count: int = 1) -> np.ndarray:
    """RMSE (3,) over flights that differ in their noise alone."""
    found = Batch(test).evaluate(np.zeros((count, 0)), 1, 0)
    assert (found.broken_limit == 0).all()
    return np.sqrt((found.inverted_rmse**2).mean(axis=0))


def with_fault(test: TestFile, target: str, value: float, fault: str = "bias") -> TestFile:
    """The test with a fault from the start on."""
    entry = FaultRange(fault=fault, target=target, value=value)
    return msgspec.structs.replace(test, faults=[entry])


@pytest.mark.parametrize("model", ["standard", "linear"])
def test_without_noise_the_inverted_models_are_right(model: str) -> None:
    found = rmse(msgspec.structs.replace(LEVEL, static_pressure=model))
    assert found == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_a_wrong_pressure_is_a_wrong_height() -> None:
    linear = msgspec.structs.replace(LEVEL, static_pressure="linear")
    found = rmse(with_fault(linear, "HIL_SENSOR.abs_pressure", 1.0))  # hPa
    assert found[HEIGHT] == pytest.approx(
        100.0 / (LEVEL.density_kgpm3 * STANDARD_GRAVITY_MPS2), rel=1e-9
    )
    _, _, density = standard_air(0.0)
    standard = rmse(with_fault(LEVEL, "HIL_SENSOR.abs_pressure", 1.0))
    assert standard[HEIGHT] == pytest.approx(100.0 / (density * STANDARD_GRAVITY_MPS2), rel=0.01)


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
    assert rmse(high)[HEIGHT] == pytest.approx(
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
    assert rmse(test, 2048)[POSITION] == pytest.approx(sigma, rel=0.05)


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
    assert found[POSITION] == pytest.approx(metres, rel=1e-3)


def test_a_lost_position_is_not_scored() -> None:
    test = msgspec.structs.replace(
        LEVEL,
        criterion="position",
        faults=[
            FaultRange(fault="bias", target="HIL_GPS.lat", value=1e4, at_s=5.0),
            FaultRange(fault="drop", target="HIL_GPS", at_s=5.0),
        ],
    )
    assert rmse(test)[POSITION] == pytest.approx(0.0, abs=1e-6)


def test_a_blocked_pitot_tube_is_a_wrong_airspeed() -> None:
    test = msgspec.structs.replace(LEVEL, criterion="airspeed")
    blocked = with_fault(test, "HIL_SENSOR.diff_pressure", 0.0, "constant")
    # All of it is missing.
    assert rmse(blocked)[AIRSPEED] == pytest.approx(35.0, abs=0.5)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"estimator": "ekf"}, "criterion: height needs all twelve states"),
        ({"vehicle": "iris", "criterion": "airspeed"}, "needs a pitot tube"),
        ({"scenario": {}}, "criterion: height is compiled for the inverse-model only"),
        (
            {"faults": [FaultRange(fault="scale", target="HIL_GPS.lat", value=2.0)]},
            "on HIL_GPS.lat is not compiled",
        ),
    ],
)
def test_criteria_that_the_kernels_cannot_evaluate_are_refused(
    changes: dict[str, object], error: str
) -> None:
    with pytest.raises((ValueError, ConfigError), match=error):
        msgspec.structs.replace(LEVEL, **changes)
