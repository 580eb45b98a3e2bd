"""The unit in which a magnitude is shown: metres, degrees and m/s, where MAVLink has integers.

Files keep the unit of the field, in which a magnitude is written; pages, tables and test names have
the unit of this module. An offset of a latitude or longitude is a distance on the ground.
"""

import math
from typing import NamedTuple

from analysis.campaign.campaign_file import MAGNITUDE, CampaignFile, FaultChoice
from mavproxy_fault.fault_parts.target import PLANT, RANGES
from mavproxy_fault.fault_parts.units import LEVELS, SIZES, VALUE_UNITS
from mavproxy_fault.faults.registry import fault_class
from mavproxy_fault.numerics.earth import curvature_radii
from mavproxy_fault.wire.dialect import find_layout
from simvehicle.scenario.scenario_file import decode_scenario, open_scenario

# The shown unit of each quantity, as `SIZES` spells it.
SHOWN = {
    "rate": "rad/s", "acceleration": "m/s/s", "field": "gauss", "pressure": "hPa", "length": "m",
    "speed": "m/s", "angle": "deg", "voltage": "V", "current": "A", "temperature": "degC",
}  # fmt: skip
SPELT = {"m/s/s": "m/s²", "rad/s/s": "rad/s²", "m/s²/s": "m/s³", "degC": "°C"}
# The units at the end of keys and plant parameters, such as `offset_m` and `wind_n_mps`.
SUFFIXES = {
    "m": "m",
    "mps": "m/s",
    "s": "s",
    "deg": "deg",
    "hz": "Hz",
    "kg": "kg",
    "kgm": "kg m",
    "k": "K",
    "a": "G/A",
    "db": "dB",
}


class MagnitudeUnit(NamedTuple):
    """`scale` converts a magnitude of the campaign file to the unit `name` ("" without one)."""

    name: str = ""
    scale: float = 1.0

    def describe(self, magnitude: float | None) -> str:
        """Return the magnitude with its unit; "" for a fault without one."""
        if magnitude is None:
            return ""
        value = magnitude * self.scale
        # Without exponents, which people read slowly, where four digits need none.
        text = f"{value:.0f}" if 1e4 <= abs(value) < 1e6 else f"{value:.4g}"
        return f"{text} {self.name}".rstrip()


def magnitude_units(campaign: CampaignFile) -> dict[str, MagnitudeUnit]:
    """Return the unit of each fault's magnitudes, by the fault's name."""
    lat_rad = 0.0
    if not campaign.compiled:
        file = campaign.scenario_arguments(campaign.scenario_names[0])[0]
        lat_rad = math.radians(decode_scenario(open_scenario(file)).start.lat_deg)
    return {fault.name: fault_unit(fault, lat_rad) for fault in campaign.all_faults.values()}


def fault_unit(choice: FaultChoice, lat_rad: float) -> MagnitudeUnit:
    """Return unit and scale in which a fault's magnitudes are shown at a latitude."""
    if choice.faults:
        # Parts with one magnitude have one unit, or none is shown.
        units = {fault_unit(part, lat_rad) for part in choice.faults}
        return units.pop() if len(units) == 1 else MagnitudeUnit()
    kind = fault_class(choice.fault) if choice.fault else None
    name = "" if kind is None else kind.name
    target = choice.target if isinstance(choice.target, str) else (choice.target or [""])[0]
    message, _, field = target.partition(".")
    if name == "plant" and message == PLANT:
        return _unit_of_key(field)
    if choice.sets != MAGNITUDE:
        return _unit_of_key(choice.sets)
    replaces = name in LEVELS or choice.also.get("mode") == "replace"
    given = VALUE_UNITS.get(name, "")
    if not given.startswith("field"):
        return MagnitudeUnit(given)
    unit = _unit_of_field(message, field, None if replaces else lat_rad)
    shown = given.replace("field", unit.name)
    return unit._replace(name=SPELT.get(shown, shown)) if unit.name else unit


def _unit_of_key(key: str) -> MagnitudeUnit:
    words = key.partition("[")[0].removesuffix("_add").split("_")
    return MagnitudeUnit(SUFFIXES.get(words[-1], "") if len(words) > 1 else "")


def _unit_of_field(message: str, field: str, lat_rad: float | None) -> MagnitudeUnit:
    """Return the unit of a field, as a distance where it is an angle on the Earth at `lat_rad`."""
    if message == RANGES:
        return MagnitudeUnit("m")
    layout = find_layout(message)
    found = None if layout is None else layout.fields.get(field.partition("[")[0])
    if found is None:
        return MagnitudeUnit()
    if found.unit == "degE7" and lat_rad is not None:
        meridian_m, prime_m = map(float, curvature_radii(lat_rad))
        radius_m = prime_m * math.cos(lat_rad) if field.startswith("lon") else meridian_m
        return MagnitudeUnit("m", math.radians(1e-7) * radius_m)
    quantity, size = SIZES.get(found.unit, ("", 1.0))
    shown = SHOWN.get(quantity, found.unit)
    scale = SIZES[shown][1] / size if quantity else 1.0
    return MagnitudeUnit(SPELT.get(shown, shown), scale)
