"""The sensors on board, each with its own state, random stream and sampling times."""

import math
from typing import Any
from zlib import crc32

import msgspec
import numpy as np

from simvehicle.environment.geomagnetism import field_ned_gauss
from simvehicle.gnss.gnss_sensor import gnss_sensor
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.readings import Reading
from simvehicle.sensors.sensor import Sensor
from simvehicle.vehicles.body import Truth


class OnboardSensor:
    """A sensor on board: its state, its random stream and when its next sample is due."""

    def __init__(self, name: str, sensor: Sensor, seed: int) -> None:
        self.name, self.sensor = name, sensor
        # Seeded by name, so that adding a sensor does not change the draws of the others.
        self.rng = np.random.default_rng([seed, crc32(name.encode())])
        self.state: Any = sensor.new_state(self.rng)
        # The first sample is due one period after the start: at t_us = 0 nothing is delivered.
        self.count = 1
        self.due_us = 1e6 / sensor.rate_hz
        self.latency_us = round(sensor.latency_s * 1e6)

    def sample(self, truth: Truth) -> list[Reading]:
        """Sample the truth; returns the readings."""
        self.count += 1
        # From the count: a period that is no integer number of microseconds must not drift.
        self.due_us = self.count * 1e6 / self.sensor.rate_hz
        readings, self.state = self.sensor.sample(truth, self.state, self.rng)
        return readings if isinstance(readings, list) else [readings]


def create_onboard_sensors(scenario: Scenario, seed: int) -> list[OnboardSensor]:
    """Create the sensors on board, the first IMU first."""
    sensors, start = scenario.sensors, scenario.start
    onboard: list[OnboardSensor] = []
    for kind in sensors.__struct_fields__:
        value = getattr(sensors, kind)
        if value is None or (kind == "gps" and scenario.gnss is not None):
            continue  # the receiver with raw observations replaces the simple one
        for index, sensor in enumerate(value if isinstance(value, list) else [value]):
            if kind == "mag" and sensor.field_ned_gauss is None:
                field = field_ned_gauss(start.lat_deg, start.lon_deg, start.alt_m, start.time)
                sensor = msgspec.structs.replace(sensor, field_ned_gauss=field)
            onboard.append(OnboardSensor(f"{kind}{index}", sensor, seed))
    if scenario.gnss is not None:
        home = math.radians(start.lat_deg), math.radians(start.lon_deg)
        onboard.append(OnboardSensor("gnss", gnss_sensor(scenario.gnss, *home), seed))
    return onboard
