"""Conversion of a fault's value between the units of one quantity, such as rad/s and mrad/s.

The units are those of MAVLink's message definitions.
"""

from collections.abc import Mapping

from mavproxy_fault.fault_parts.elements import Element
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.wire.dialect import message_layout

# Unit: its quantity, and its number per SI unit of the quantity (angles: per degree).
SIZES: dict[str, tuple[str, float]] = {
    "rad/s": ("rate", 1.0), "mrad/s": ("rate", 1e3),
    "m/s/s": ("acceleration", 1.0), "mG": ("acceleration", 1e3 / STANDARD_GRAVITY_MPS2),
    "gauss": ("field", 1.0), "mgauss": ("field", 1e3),
    "Pa": ("pressure", 1.0), "hPa": ("pressure", 1e-2),
    "m": ("length", 1.0), "dm": ("length", 1e1), "cm": ("length", 1e2), "mm": ("length", 1e3),
    "m/s": ("speed", 1.0), "dm/s": ("speed", 1e1), "cm/s": ("speed", 1e2), "mm/s": ("speed", 1e3),
    "deg": ("angle", 1.0), "cdeg": ("angle", 1e2), "degE7": ("angle", 1e7), "degE5": ("angle", 1e5),
    "V": ("voltage", 1.0), "cV": ("voltage", 1e2), "mV": ("voltage", 1e3),
    "A": ("current", 1.0), "cA": ("current", 1e2), "mA": ("current", 1e3),
    "degC": ("temperature", 1.0), "cdegC": ("temperature", 1e2),
}  # fmt: skip
LEVELS = ("constant", "saturate")  # faults whose value replaces that of the field
# The unit of a fault's `value`, in which `field` is that of the field. The value of all others is a
# share, a factor or a number of something.
VALUE_UNITS = {
    **dict.fromkeys(("bias", "noise", "sine", "impulse", "cycle", "quantise"), "field"),
    **dict.fromkeys(("dead-band", *LEVELS), "field"), "random-walk": "field/√s",
    "drift": "field/s", "slew-limit": "field/s",
    "gps-spoof": "m", "rate-limit": "Hz", "time-drift": "s/s", "time-backwards": "s/s",
    **dict.fromkeys(("delay", "jitter", "lag", "replay", "sample-hold", "time-jump"), "s"),
}  # fmt: skip

Factors = Mapping[int, tuple[float, ...]]


def factors_of(elements: Mapping[int, tuple[Element, ...]]) -> Factors:
    """Return the factor from the unit of the first target of a quantity to that of each element.

    Messages with factors of 1 only are omitted.
    """
    first: dict[str, float] = {}
    found: dict[int, tuple[float, ...]] = {}
    for number, listed in elements.items():
        described = message_layout(number)
        row = []
        for one in listed:
            quantity, size = SIZES.get(described.fields[one.name].unit, ("", 1.0))
            # A field of unknown quantity is not converted.
            row.append(size / first.setdefault(quantity, size) if quantity else 1.0)
        if any(factor != 1.0 for factor in row):
            found[number] = tuple(row)
    return found
