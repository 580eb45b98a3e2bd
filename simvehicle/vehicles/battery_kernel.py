"""Voltage and remaining charge of a battery pack, compiled into the flight of a vehicle."""

from typing import NamedTuple

from mavproxy_fault.numerics.compile import inlined


class BatterySupply(NamedTuple):
    """A lithium-polymer pack; plant faults set the scales of voltage and resistance.

    `full_throttle_a` is the current at full throttle, for a vehicle whose motor model has none.
    """

    cells: float
    capacity_ah: float
    resistance_ohm: float
    full_throttle_a: float
    voltage_scale: float = 1.0
    resistance_scale: float = 1.0


@inlined
def battery_output(supply: BatterySupply, drawn_as: float, current_a: float) -> tuple[float, float]:
    """Terminal voltage [V] and the charge remaining (0 to 1) after `drawn_as` ampere seconds.

    The open-circuit voltage falls from 4.2 to 3.7 V per cell over most of the charge and to 3.0 V
    over the last tenth, a piecewise linear approximation of a lithium-polymer cell.
    """
    # 3600 A s are 1 A h.
    charge = min(1.0, max(0.0, 1.0 - drawn_as / (3600.0 * supply.capacity_ah)))
    # The two lines meet at a tenth of the charge, at 3.66 V per cell.
    cell = 3.6 + 0.6 * charge if charge > 0.1 else 3.0 + 6.6 * charge
    drop = supply.resistance_ohm * (current_a * supply.resistance_scale)
    return max(0.0, supply.cells * cell - drop) * supply.voltage_scale, charge
