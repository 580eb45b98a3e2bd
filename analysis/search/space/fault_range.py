"""Faults of a test file: kind, target, magnitude, onset and duration, each fixed or searched."""

from typing import Any

import numpy as np
from msgspec import field

from analysis.flying.onset import onset_keys
from analysis.search.space.section import Range, Section
from mavproxy_fault.numerics.earth import curvature_radii

# Latitude of compiled flights: normal gravity at sea level is 9.80665 m/s^2 there (WGS 84).
LATITUDE_DEG = 45.497
_MERIDIAN_M, _PRIME_M = map(float, curvature_radii(np.radians(LATITUDE_DEG)))
METRES_PER_LAT = float(np.radians(1e-7) * _MERIDIAN_M)
METRES_PER_LON = float(np.radians(1e-7) * _PRIME_M * np.cos(np.radians(LATITUDE_DEG)))

# message field -> measured channel (see `rows`) and SI units per unit of the field
CHANNELS: dict[str, tuple[int, float]] = {
    "HIL_SENSOR.xgyro": (0, 1.0),
    "HIL_SENSOR.ygyro": (1, 1.0),
    "HIL_SENSOR.zgyro": (2, 1.0),
    "HIL_SENSOR.xacc": (3, 1.0),
    "HIL_SENSOR.yacc": (4, 1.0),
    "HIL_SENSOR.zacc": (5, 1.0),
    "HIL_SENSOR.xmag": (6, 1.0),
    "HIL_SENSOR.ymag": (7, 1.0),
    "HIL_SENSOR.zmag": (8, 1.0),
    "HIL_GPS.vn": (9, 0.01),
    "HIL_GPS.ve": (10, 0.01),
    "HIL_GPS.vd": (11, 0.01),
    "HIL_SENSOR.diff_pressure": (12, 100.0),
    "HIL_SENSOR.abs_pressure": (13, 100.0),
    # Metres per 1e-7 degree at this latitude; height is against down.
    "HIL_GPS.lat": (14, METRES_PER_LAT),
    "HIL_GPS.lon": (15, METRES_PER_LON),
    "HIL_GPS.alt": (16, -0.001),
}
# Kernel positions are relative to the start: scaling or setting an absolute latitude is impossible.
POSITION_FIELDS = ("HIL_GPS.lat", "HIL_GPS.lon", "HIL_GPS.alt")
POSITION_FAULTS = ("bias", "drift", "freeze", "noise")
# The first of three velocity channels.
DROP_CHANNELS = {"HIL_GPS": (9, 1.0)}  # messages that `drop` may remove, by their first channel
COMPILED_FAULTS = ("bias", "constant", "drift", "drop", "freeze", "noise", "scale")
VALUELESS_FAULTS = ("drop", "freeze")


class FaultRange(Section, frozen=True):
    """One fault as in a schedule; units are the field's.

    With `any_of` the target is searched too, with several onsets `on` (flight events or conditions,
    "" for seconds) the onset; `at_s` then counts from it. `also` holds further keys of the fault.
    """

    fault: str
    target: str | None = None
    any_of: list[str] = field(default_factory=list)
    value: Range | None = None
    at_s: Range = 0.0
    for_s: Range | None = None
    on: list[str] = field(default_factory=lambda: [""])
    also: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        # One or the other: both would be ambiguous.
        if (self.target is None) == (not self.any_of):
            raise ValueError("give exactly one of target and any_of")
        for onset in filter(None, self.on):
            onset_keys(onset)

    @property
    def targets(self) -> list[str]:
        """The possible targets."""
        return [self.target] if self.target is not None else self.any_of

    def ranges(self) -> dict[str, Range]:
        """The numbers and ranges in the file, by key."""
        values = {"value": self.value, "at_s": self.at_s, "for_s": self.for_s}
        return {key: value for key, value in values.items() if value is not None}

    # The simulator has all faults, the kernels only some.
    def check_compiled(self) -> None:
        """Raise ValueError if the compiled kernels do not have this fault."""
        if self.fault not in COMPILED_FAULTS:
            raise ValueError(
                f"faults.fault {self.fault!r} is not compiled; known: {', '.join(COMPILED_FAULTS)}"
                " (all of the proxy's with `scenario`)"
            )
        if self.also:
            raise ValueError(f"faults.also is not compiled for {self.fault!r}; leave it out")
        if self.value is None and self.fault not in VALUELESS_FAULTS:
            raise ValueError(f"faults.value is missing for {self.fault!r}; a number or a range")
        channels = DROP_CHANNELS if self.fault == "drop" else CHANNELS
        for target in self.targets:
            if target not in channels:
                raise ValueError(f"target {target!r} is unknown; known: {', '.join(channels)}")
            if target in POSITION_FIELDS and self.fault not in POSITION_FAULTS:
                raise ValueError(
                    f"faults.fault {self.fault!r} on {target} is not compiled; known: "
                    f"{', '.join(POSITION_FAULTS)}"
                )


def healthy_value(fault: str) -> float:
    """The value of a kind of fault that changes nothing."""
    # A scale of one is no fault; of everything else zero is.
    return 1.0 if fault == "scale" else 0.0
