"""The interface and the common parameters of all sensors."""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import msgspec
import numpy as np

from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth


class Sensor(Protocol):
    """A sensor's frozen parameters; its state is passed in and returned."""

    @property
    def rate_hz(self) -> float:
        """Samples per second."""

    @property
    def latency_s(self) -> float:
        """Delay from measurement to delivery."""

    def new_state(self, rng: np.random.Generator) -> Any:
        """State at power-on."""

    def sample(
        self, truth: Truth, state: Any, rng: np.random.Generator
    ) -> tuple[Reading | list[Reading], Any]:
        """Sample the truth: one reading, or several, and the new state."""


class SensorParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters common to all sensors; `latency_s` is the delay from measurement to delivery.

    `channels` is the number of channels of each of the sensor's noise models, whose states together
    are the state of the sensor.
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
        # An id is one byte on the wire.
        if not 0 <= self.id <= 255:
            raise ValueError(f"id = {self.id} is out of range; 0 to 255 is allowed")
        for name, count in self.channels.items():
            bias = self.noise_model(name).bias
            if isinstance(bias, list) and len(bias) != count:
                raise ValueError(
                    f"{name}.bias has {len(bias)} numbers; one, or a list of {count}, is allowed"
                )

    def noise_model(self, name: str) -> NoiseModel:
        """The noise model of that name."""
        model: NoiseModel = getattr(self, name)
        return model

    def new_state(self, rng: np.random.Generator) -> list[NoiseState]:
        """Draw the constant errors and the first block of each noise model."""
        return [
            self.noise_model(name).new_state(rng, count, self.rate_hz)
            for name, count in self.channels.items()
        ]

    def next_errors(
        self, state: list[NoiseState], rng: np.random.Generator
    ) -> tuple[list[list[float]], list[NoiseState]]:
        """The errors of the next sample, a list for each noise model, and the next state."""
        drawn = [
            self.noise_model(name).next(noise, rng, self.rate_hz)
            for name, noise in zip(self.channels, state, strict=True)
        ]
        return [errors for errors, _ in drawn], [noise for _, noise in drawn]
