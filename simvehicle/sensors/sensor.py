"""The interface and the common parameters of sensors; their state is passed in and returned."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotNegative
from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth

Rate = Annotated[float, Meta(gt=0, le=2000)]


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

    def sample(
        self, truth: Truth, state: list[NoiseState], rng: np.random.Generator
    ) -> tuple[Reading, list[NoiseState]]:
        """Draw the errors of the next sample and measure with them."""
        drawn = [
            self.noise_model(name).next(noise, rng, self.rate_hz)
            for name, noise in zip(self.channels, state, strict=True)
        ]
        return self.measure(truth, *(errors for errors, _ in drawn)), [noise for _, noise in drawn]

    def measure(self, truth: Truth, *errors: list[float]) -> Any:
        """The reading of the truth, with the errors of each noise model; a kind defines it."""
        raise NotImplementedError
