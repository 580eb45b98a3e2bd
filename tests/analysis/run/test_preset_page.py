"""docs/presets.md agrees with flights: a selection of its rows, flown again."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[3] / "benchmarks" / "preset_table.py"
# Of each vehicle, one of each kind that no other test flies: `preset_table.py --check` flies all.
FLOWN = (
    *(("fixed wing", name) for name in ("gps-velocity-error", "airspeed-blockage")),
    *(("quad", name) for name in ("gnss-spoof-jump", "gps-cold-start")),
    *(("quad", name) for name in ("actuator-stuck", "baro-off")),
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
def test_a_row_matches_its_flight(script: ModuleType, job: tuple[str, str]) -> None:
    (row,) = [row for row in script.page_rows() if (row.vehicle, row.preset) == job]
    assert script.fly_preset(job) == row
