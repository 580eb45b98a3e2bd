"""The interface and the common parameters of sensors; their state is passed in and returned."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotNegative, Section
from simvehicle.sensors.error_model import BLOCK, NoiseModel, NoiseState
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth

Rate = Annotated[float, Meta(gt=0, le=2000)]


class DrawnErrors(NamedTuple):
    """The row of the next sample in the blocks of errors, and the state of each noise model."""

    row: int
    noises: list[NoiseState]


class SensorParameters(Section, frozen=True):
    """Parameters common to all sensors; `latency_s` is the delay from measurement to delivery.

    `channels` is the number of channels of each of the sensor's noise models.
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

    def new_state(self, rng: np.random.Generator) -> DrawnErrors:
        """Draw the constant errors and the first block of each noise model."""
        models = ((self.noise_model(name), count) for name, count in self.channels.items())
        return DrawnErrors(0, [model.new_state(rng, n, self.rate_hz) for model, n in models])

    def next_blocks(self, state: DrawnErrors, rng: np.random.Generator) -> DrawnErrors:
        """Draw the next block of each noise model."""
        pairs = zip(map(self.noise_model, self.channels), state.noises, strict=True)
        return DrawnErrors(0, [model.refill(noise, rng, self.rate_hz) for model, noise in pairs])

    def sample(
        self, truth: Truth, state: DrawnErrors, rng: np.random.Generator
    ) -> tuple[Reading, DrawnErrors]:
        """Measure with the errors of the next sample."""
        row, noises = self.next_blocks(state, rng) if state.row == BLOCK else state
        reading = self.measure(truth, *(noise.block[row].tolist() for noise in noises))
        return reading, DrawnErrors(row + 1, noises)

    def measure(self, truth: Truth, *errors: list[float]) -> Any:
        """The reading of the truth, with the errors of each noise model; a kind defines it."""
        raise NotImplementedError
