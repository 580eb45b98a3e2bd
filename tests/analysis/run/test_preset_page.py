"""Compares a sample of the rows of docs/presets.md with new flights."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[3] / "benchmarks" / "preset_table.py"
FLOWN = (
    *(("fixed wing", name) for name in ("clock-jump", "gnss-carry-off", "gps-velocity-error")),
    *(("fixed wing", name) for name in ("gps-receiver-off", "airspeed-blockage")),
    *(("quad", name) for name in ("gnss-spoof-jump", "gps-jump", "gps-cold-start", "gyro-bias")),
    *(("quad", name) for name in ("actuator-stuck", "baro-off", "satellite-step")),
)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("preset_table", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["preset_table"] = module
    spec.loader.exec_module(module)
    return module


def test_every_preset_has_its_row_for_each_vehicle(script: ModuleType) -> None:
    rows = [(row.vehicle, row.preset) for row in script.page_rows()]
    assert rows == [(vehicle, name) for vehicle in script.VEHICLES for name in script.PRESETS]


def test_no_healthy_sensor_is_isolated(script: ModuleType) -> None:
    assert [row.preset for row in script.page_rows() if "wrong" in row.cells[1]] == []


@pytest.mark.parametrize("job", FLOWN, ids=" ".join)
def test_a_row_agrees_with_its_flight(script: ModuleType, job: tuple[str, str]) -> None:
    (row,) = [row for row in script.page_rows() if (row.vehicle, row.preset) == job]
    assert script.fly_preset(job) == row
