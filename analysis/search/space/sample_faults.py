"""Faults on samples in arrays, as the proxy's of the same names act on the fields of messages."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.samples.block import AIRSPEED, BARO, FIX, FORCE, IMU, MAG, Block
from mavproxy_fault.numerics.arrays import Array

# Kind, column and unit of a message's field in a row.
FIELDS: dict[str, tuple[int, int, float]] = {
    **{f"HIL_SENSOR.{axis}gyro": (IMU, i, 1.0) for i, axis in enumerate("xyz")},
    **{f"HIL_SENSOR.{axis}acc": (IMU, FORCE + i, 1.0) for i, axis in enumerate("xyz")},
    **{f"HIL_SENSOR.{axis}mag": (MAG, i, 1.0) for i, axis in enumerate("xyz")},
    "HIL_SENSOR.diff_pressure": (AIRSPEED, 0, 100.0),
    "HIL_SENSOR.abs_pressure": (BARO, 0, 100.0),
    "HIL_GPS.lat": (FIX, 0, 1e-7),
    "HIL_GPS.lon": (FIX, 1, 1e-7),
    "HIL_GPS.alt": (FIX, 2, 1e-3),
    **{f"HIL_GPS.v{axis}": (FIX, 3 + i, 0.01) for i, axis in enumerate("ned")},
}
DROPPED = {"HIL_GPS": FIX}  # messages that `drop` may remove
SAMPLE_FAULTS = ("bias", "constant", "drift", "drop", "freeze", "noise", "scale")
VALUELESS = ("drop", "freeze")


def break_samples(samples: Block, faults: Sequence[Mapping[str, Any]], seed: int) -> Block:
    """The samples with faults, each an entry of a schedule; `seed` is that of their noise."""
    values, kept = samples.values.copy(), np.ones(len(samples.kind), bool)
    elapsed_s = (samples.t_us - samples.t_us[0]) * 1e-6
    for number, fault in enumerate(faults):
        since_s = elapsed_s - fault["at_s"]
        kind, column, unit = FIELDS.get(fault["target"]) or (DROPPED[fault["target"]], 0, 1.0)
        active = (samples.kind == kind) & (since_s >= 0.0) & (since_s < fault.get("for_s", np.inf))
        if fault["fault"] == "drop":
            kept &= ~active
            continue
        rng = np.random.default_rng([seed, number])
        size = fault.get("value", 0.0)
        size = size if fault["fault"] == "scale" else size * unit
        values[active, column] = broken_values(
            fault["fault"], values[active, column], size, since_s[active], rng
        )
    broken = samples._replace(values=values)
    return broken if kept.all() else broken.where(kept)


def broken_values(
    fault: str, healthy: Array, size: float, since_s: Array, rng: np.random.Generator
) -> Array | float:
    """What a fault of a size makes of healthy values (n,), `since_s` (n,) after its begin."""
    if fault == "bias":
        return healthy + size
    if fault == "drift":
        return healthy + size * since_s
    if fault == "noise":
        return healthy + size * rng.standard_normal(len(healthy))
    if fault == "scale":
        return healthy * size
    if fault == "freeze":
        return healthy[:1]
    return size  # constant
