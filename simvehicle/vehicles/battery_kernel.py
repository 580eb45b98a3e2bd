"""What a pack gives while charge is drawn from it, compiled into the flight of a vehicle."""

from typing import NamedTuple

from mavproxy_fault.numerics.compile import inlined


class BatterySupply(NamedTuple):
    """A lithium-polymer pack with its faults; resistance and voltage are scaled by them.

    `full_throttle_a` is the current at full throttle of a vehicle whose motor has no model of it.
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
    over the last tenth, a straight-line picture of a lithium-polymer cell's curve.
    """
    # 3600 ampere seconds are an ampere hour.
    charge = min(1.0, max(0.0, 1.0 - drawn_as / (3600.0 * supply.capacity_ah)))
    # Two straight lines that meet at a tenth of the charge: 3.66 V per cell.
    cell = 3.6 + 0.6 * charge if charge > 0.1 else 3.0 + 6.6 * charge
    fall = supply.resistance_ohm * (current_a * supply.resistance_scale)
    return max(0.0, supply.cells * cell - fall) * supply.voltage_scale, charge
