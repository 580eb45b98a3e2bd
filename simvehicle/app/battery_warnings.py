"""Tells whoever flies that the simulated battery runs low; an autopilot may have its own gauge."""

from collections.abc import Callable

from simvehicle.vehicles.body import Truth

WARNING_LEVELS = (
    (0.2, "a fifth of the simulated battery is left"),
    (0.0, "the simulated battery is empty and the motors stop; a larger one is a matter of "
          "`battery.capacity_ah` in a parameter file"),
)  # fmt: skip


class BatteryWarnings:
    """One flight's battery; each mark is told once, to `say`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._marks = list(WARNING_LEVELS)

    def update(self, truth: Truth) -> None:
        """Called each step."""
        while self._marks and truth.battery_remaining <= self._marks[0][0]:
            _, text = self._marks.pop(0)
            self._say(f"{truth.t_us * 1e-6:8.1f} s {text}")
