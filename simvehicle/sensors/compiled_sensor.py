"""Sensors whose samples are computed by compiled code, since every step of a flight has some.

A kind has its parameters and its `measure_*` function in one file, and a branch in `measure`. It
writes at most six numbers to `values` of its record. All other sensors have a `sample` in Python.
"""

from typing import Any, ClassVar

import numpy as np

from simvehicle.sensors.sensor import SensorParameters

IMU, MAG, BARO, PITOT = range(4)  # kinds


class CompiledSensor(SensorParameters, frozen=True, kw_only=True):
    """Parameters of a compiled sensor."""

    kind: ClassVar[int]
    constants: ClassVar[tuple[str, ...]] = ()  # parameters that its `measure_*` takes, in order

    def describe(self, record: Any) -> None:
        """Write the parameters to a record of `SENSOR`."""
        record["kind"], record["id"], record["rate_hz"] = self.kind, self.id, self.rate_hz
        for at, name in enumerate(self.channels):
            record["scale"][at] = self.noise_model(name).scale
        values = np.hstack([getattr(self, name) for name in self.constants] or [0.0])
        record["constants"][: len(values)] = values
