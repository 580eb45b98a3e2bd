"""Warns the user that the simulated battery runs low; the autopilot's own gauge may differ."""

from collections.abc import Callable

from simvehicle.vehicles.body import Truth

WARNING_LEVELS = (
    (0.2, "20 % of the simulated battery is left"),
    (0.0, "the simulated battery is empty and the motors stop; increase `battery.capacity_ah` in "
          "the vehicle's parameter file"),
)  # fmt: skip


class BatteryWarnings:
    """Warnings about the battery of one flight; each level is reported once, through `say`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._levels = list(WARNING_LEVELS)

    def update(self, truth: Truth) -> None:
        """Report the levels reached; called each step."""
        while self._levels and truth.battery_remaining <= self._levels[0][0]:
            _, text = self._levels.pop(0)
            self._say(f"{truth.t_us * 1e-6:8.1f} s {text}")
