"""The sensors on board, each with its own state, random stream and sampling times."""

import math
from datetime import datetime
from typing import Any
from zlib import crc32

import msgspec
import numpy as np

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.magnetic_field import magnetic_field_gauss
from simvehicle.gnss.constellation import build_constellation
from simvehicle.gnss.gnss_sensor import GnssSensor
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.compiled_sensor import CompiledSensor
from simvehicle.sensors.error_model import BLOCK
from simvehicle.sensors.flight_record import SENSOR, Records
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth


class OnboardSensor:
    """A sensor on board: its state, its random stream and when its next sample is due."""

    def __init__(self, name: str, sensor: Any, seed: int) -> None:
        self.name, self.sensor = name, sensor
        # Seeded by name, so that adding a sensor does not change the draws of the others.
        self.rng = np.random.default_rng([seed, crc32(name.encode())])
        self.state: Any = sensor.new_state(self.rng)
        # The first sample is due one period after the start: at t_us = 0 nothing is delivered.
        self._count = 1
        self.due_us = 1e6 / sensor.rate_hz
        self.latency_us = round(sensor.latency_s * 1e6)

    def sample(self, truth: Truth) -> list[Reading]:
        """Sample the truth; returns the readings."""
        self._count += 1
        # From the count: a period that is no integer number of microseconds must not drift.
        self.due_us = self._count * 1e6 / self.sensor.rate_hz
        readings, self.state = self.sensor.sample(truth, self.state, self.rng)
        return readings if isinstance(readings, list) else [readings]


class CompiledOnboardSensor(OnboardSensor):
    """A compiled sensor on board; `record` of `SENSOR` has its parameters and sampling times."""

    def __init__(self, name: str, sensor: CompiledSensor, seed: int, record: Any) -> None:
        super().__init__(name, sensor, seed)
        self.record = record
        sensor.describe(record)
        record["count"], record["due_us"] = self._count, self.due_us
        self._put_errors()

    def refill(self) -> None:
        """Draw the next block of errors if the last one is used up."""
        if self.record["row"] == BLOCK:
            self.state = self.sensor.next_blocks(self.state, self.rng)
            self._put_errors()

    def _put_errors(self) -> None:
        blocks = np.hstack([noise.block for noise in self.state.noises])
        self.record["errors"][:, : blocks.shape[1]] = blocks
        self.record["row"] = 0


def create_onboard_sensors(
    scenario: Scenario, seed: int
) -> tuple[list[CompiledOnboardSensor], list[OnboardSensor], Records]:
    """Create the compiled sensors, the first IMU first, the other sensors, and the former's
    records."""
    sensors, start = scenario.sensors, scenario.start
    found: list[tuple[str, Any]] = []
    for kind in sensors.__struct_fields__:
        value = getattr(sensors, kind)
        if value is None or (kind == "gps" and scenario.gnss is not None):
            continue  # the receiver with raw observations replaces the simple one
        for index, sensor in enumerate(value if isinstance(value, list) else [value]):
            if kind == "mag" and sensor.field_ned_gauss is None:
                field = field_ned_gauss(start.lat_deg, start.lon_deg, start.alt_m, start.time)
                sensor = msgspec.structs.replace(sensor, field_ned_gauss=field)
            found.append((f"{kind}{index}", sensor))
    if scenario.gnss is not None:
        home = math.radians(start.lat_deg), math.radians(start.lon_deg)
        constellation = build_constellation(scenario.gnss, *home)
        found.append(("gnss", GnssSensor(scenario.gnss, constellation)))
    fast = [each for each in found if isinstance(each[1], CompiledSensor)]
    records = np.zeros(len(fast), dtype=SENSOR)
    compiled = [
        CompiledOnboardSensor(*each, seed, record)
        for each, record in zip(fast, records, strict=True)
    ]
    return compiled, [OnboardSensor(*each, seed) for each in found if each not in fast], records


def field_ned_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """The Earth's magnetic field (north, east, down) at a position and time [gauss].

    Raises
    ------
    ConfigError
        If no model covers the time.
    """
    try:
        return magnetic_field_gauss(lat_deg, lon_deg, height_m, time)
    except ValueError:
        raise ConfigError(
            f"no world magnetic model covers start.time = {time:%Y-%m-%d}; use 2010 to 2029, "
            "or set sensors.mag.field_ned_gauss"
        ) from None
