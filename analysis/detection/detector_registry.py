"""The protocol of the monitor's detectors, and other packages' detectors, named by entry points."""

from functools import cache
from typing import Any, ClassVar

import msgspec

from analysis.results import SensorDecision
from analysis.samples.block import Block

GROUP = "mavproxy_fault.detectors"
REPEAT_US = 500_000  # between two alarms about one fault: a reader and the report need no more
ENDED_US = 3 * REPEAT_US  # an alarm that was not repeated for so long, twice missed, has ended
USUAL_US = 20_000_000  # after which a lasting change of level or rate is the new usual one
RowResults = list[tuple[int, SensorDecision]]  # each with its row of the block


class BlockDetector(msgspec.Struct, frozen=True):
    """One test of the samples, independent of the navigation filter; its fields are its settings.

    `channels` are the sensors that its results name. `sees` are channels, messages or targets
    (`baro`, `BATTERY_STATUS`, `PLANT.mass_kg`): a fault of one of them can be detected here.
    `state` is the class of its state; its default values are the initial state.
    """

    channels: ClassVar[frozenset[str]] = frozenset()
    sees: ClassVar[frozenset[str]] = frozenset()
    state: ClassVar[type[Any] | None] = None

    def new_state(self) -> Any:
        """The state before the first sample."""
        return None if self.state is None else self.state()

    def step(self, block: Block, state: Any) -> tuple[RowResults, Any]:
        """The results of the next samples, each with its row of the block, and the next state."""
        raise NotImplementedError


@cache
def other_detectors() -> dict[str, type[BlockDetector]]:
    """Name to class of the detectors of other packages, sorted by name."""
    from importlib.metadata import entry_points  # takes 50 ms, which few commands need

    return {point.name: point.load() for point in sorted(entry_points(group=GROUP))}
