"""The data of the fault form: units of values and of previews."""

import msgspec
import pytest

from analysis.web.form_data import fault_catalogue, preview_entry
from mavproxy_fault.fault_parts.units import VALUE_UNITS
from mavproxy_fault.faults.registry import known_faults


def test_a_value_has_the_unit_of_its_field_or_one_of_its_own() -> None:
    catalogue = msgspec.json.decode(fault_catalogue())
    units = [catalogue["faults"][name]["unit"] for name in ("bias", "drift", "delay", "drop")]
    assert units == ["field", "field/s", "s", ""]
    assert catalogue["units"]["HIL_GPS.lat"] == "1e-7 deg"
    assert set(VALUE_UNITS) <= set(known_faults())


@pytest.mark.parametrize(("field", "metres"), [("lat", 10.0), ("lon", 6.8)])
def test_the_preview_of_a_position_shows_its_change_in_metres(field: str, metres: float) -> None:
    bias = {"fault": "bias", "target": f"HIL_GPS.{field}", "value": 900, "at_s": 2, "for_s": 4}
    (curve,) = preview_entry(msgspec.json.encode(bias))["curves"]
    assert curve["name"] == f"change of HIL_GPS.{field}, m"
    assert max(curve["faulty"]) == pytest.approx(metres, abs=0.05)
