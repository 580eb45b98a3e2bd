"""Changes of the plant that come over a link: carried out, or refused with a word and no more.

They come from a peer, who may be wrong, and five times a second: each refusal is told once.
"""

from collections.abc import Callable
from typing import Protocol

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.plant_messages import plant_change


class ChangeablePlant(Protocol):
    """What can be changed."""

    def plant(self, name: str, value: float | None) -> None:
        """Change a parameter of the plant; None makes it healthy again."""


class PlantChanges:
    """The control path's end at one simulation."""

    def __init__(self, plant: ChangeablePlant, say: Callable[[str], None]) -> None:
        self._plant = plant
        self._say = say
        self._refused: set[str] = set()

    def carry_out(self, frame: Frame) -> None:
        """Carry out a change; other frames pass unheeded."""
        change = plant_change(frame)
        if change is None:
            return
        try:
            self._plant.plant(change.name, change.value)
        except ConfigError as error:
            if change.name not in self._refused:
                self._refused.add(change.name)
                self._say(str(error))
