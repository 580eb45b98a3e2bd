"""Parameters that a plant fault can set in the simulator, by their names after `PLANT.`.

`[i]` is a motor, `[G12]` a satellite, `[G]` all of GPS, `[E]` of Galileo, `[all]` both. Only the
simulator knows which of them a vehicle has: a fixed wing has no second motor.
"""

import re

from mavproxy_fault.documents.suggestion import suggest_known

AIRFRAME = ("mass_kg_add", "inertia_scale", "load_shift_x_m", "load_shift_y_m")
MOTOR = ("motor_efficiency", "propeller_efficiency", "rotor_unbalance_kgm", "thrust_ripple")
SURFACE = ("elevator_efficiency", "aileron_efficiency", "rudder_efficiency")
BATTERY = ("battery_voltage_scale", "battery_resistance_scale")
WIND = ("wind_n_mps", "wind_e_mps", "wind_d_mps")
COMPASS = ("compass_x_gauss_per_a", "compass_y_gauss_per_a", "compass_z_gauss_per_a")
SENSORS = ("sensor_warming_k", *COMPASS)
RECEIVER = ("receiver_off",)
SATELLITE = ("pseudorange_m", "cn0_drop_db", "satellite_lost", "range_rate_mps")
SPOOF = ("spoof_north_m", "spoof_east_m", "spoof_down_m", "spoof_clock_m")
# Spoofed positions that move faster are position jumps and produce no Doppler.
FASTEST_SPOOF_MPS = 500.0
GROUPS = ("all", "G", "E")  # groups of satellites: all, GPS, Galileo

# Satellite numbers of GPS and Galileo (RTCM 10403.3, MSM satellite masks).
SATELLITES = (*(f"G{n:02d}" for n in range(1, 33)), *(f"E{n:02d}" for n in range(1, 37)))
SATELLITE_NAME = re.compile(r"G(0[1-9]|[12]\d|3[0-2])|E(0[1-9]|[12]\d|3[0-6])")
SIGNALS = (*SATELLITE, *SPOOF)
INDEXED = re.compile(r"(\w+)\[(\w+)\]")


def check_plant_name(name: str) -> None:
    """Refuse a name that no simulated vehicle has.

    Raises
    ------
    ValueError
        With similar names.
    """
    parts = INDEXED.fullmatch(name)
    if parts is None:
        if name in (single := (*AIRFRAME, *SURFACE, *BATTERY, *WIND, *SENSORS, *RECEIVER)):
            return
        known = [*single, *(f"{one}[0]" for one in MOTOR), *(f"{one}[all]" for one in SIGNALS)]
        raise ValueError(f"{name} is not a plant parameter; {suggest_known(name, known)}")
    base, index = parts.groups()
    if base not in (*MOTOR, *SIGNALS):
        raise ValueError(
            f"{name} is not a plant parameter; {suggest_known(base, (*MOTOR, *SIGNALS))}"
        )
    if base in MOTOR and not (index.isascii() and index.isdigit()):
        raise ValueError(f"{name} does not name a motor; write e.g. {base}[0]")
    if base in SIGNALS and index not in GROUPS and not SATELLITE_NAME.fullmatch(index):
        raise ValueError(f"{name} does not name a satellite; use [all], [G], [E] or e.g. [G12]")
