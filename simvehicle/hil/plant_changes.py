"""Plant faults that arrive on a link: applied to the simulation, or refused with a message.

A peer repeats them five times a second, so each refusal is reported once.
"""

from collections.abc import Callable

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.plant_messages import plant_change


class PlantChanges:
    """Applies the plant faults received on a link to one simulation by its function `plant`."""

    def __init__(
        self, plant: Callable[[str, float | None], None], say: Callable[[str], None]
    ) -> None:
        self._plant = plant
        self._say = say
        self._refused: set[str] = set()

    def carry_out(self, frame: Frame) -> None:
        """Apply the plant fault in a frame; other frames are ignored."""
        change = plant_change(frame)
        if change is None:
            return
        try:
            self._plant(change.name, change.value)
        except ConfigError as error:
            if change.name not in self._refused:
                self._refused.add(change.name)
                self._say(str(error))
