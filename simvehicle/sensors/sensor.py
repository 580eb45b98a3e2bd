"""What every sensor is, and how often it speaks."""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import msgspec
import numpy as np

from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth


class Sensor(Protocol):
    """Frozen parameters; the moving state is handed in and back."""

    @property
    def rate_hz(self) -> float:
        """Samples per second."""

    @property
    def latency_s(self) -> float:
        """From measurement to delivery."""

    def new_state(self, rng: np.random.Generator) -> Any:
        """State at power-on."""

    def sample(
        self, truth: Truth, state: Any, rng: np.random.Generator
    ) -> tuple[Reading | list[Reading], Any]:
        """One reading of the truth."""


class SensorParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters that all sensors have; `latency_s` is from measurement to delivery.

    `channels` says how many channels each of a sensor's noises has.
    """

    channels: ClassVar[Mapping[str, int]] = {}

    rate_hz: float
    latency_s: float = 0.0
    id: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz <= 2000.0:
            raise ValueError(f"rate_hz = {self.rate_hz} is out of range; above 0, at most 2000")
        if self.latency_s < 0.0:
            raise ValueError(f"latency_s = {self.latency_s} is negative; 0 or more is allowed")
        # On the wire an id is one byte.
        if not 0 <= self.id <= 255:
            raise ValueError(f"id = {self.id} is out of range; 0 to 255 is allowed")
        for name, count in self.channels.items():
            bias = getattr(self, name).bias
            if isinstance(bias, list) and len(bias) != count:
                raise ValueError(
                    f"{name}.bias has {len(bias)} numbers; one, or a list of {count}, is allowed"
                )
