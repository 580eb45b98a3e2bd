"""The interface and the common parameters of all sensors."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotNegative
from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth

Rate = Annotated[float, Meta(gt=0, le=2000)]


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

    rate_hz: Rate
    latency_s: NotNegative = 0.0
    id: Annotated[int, Meta(ge=0, le=255)] = 0  # one byte on the wire

    def __post_init__(self) -> None:
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
