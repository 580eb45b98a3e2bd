"""Static pressure and GPS position over lanes, and what inverting the sensors' models makes of
them: height above ground, airspeed, position; scored against the truth."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, air_velocity, draw
from mavproxy_fault.numerics.compile import compiled, inlined
from simvehicle.environment.air import SEA_LEVEL_K, pressure_altitude, standard_air
from simvehicle.vehicles.rigidbody_kernel import DOWN

L = rows.LANES
NOW = rows.NOW * L
N, ALIVE = rows.NOISE * L, rows.ALIVE * L
STATIC, PITOT, PLACE = rows.ABS_PRESSURE * L, rows.DIFF_PRESSURE * L, rows.PLACE * L
VELOCITY = rows.VELOCITY * L
START, ERROR = rows.START_DOWN * L, rows.PLACE_ERROR * L
SIGMA, BIAS, DRIFT = rows.STATIC_SIGMA * L, rows.STATIC_BIAS * L, rows.STATIC_DRIFT * L
KICK = rows.PLACE_KICK * L
SCORES = rows.INVERTED_SQUARES * L
HEIGHT, AIRSPEED, POSITION = range(3)  # places among the scores; their counts follow
PRESSURES, PLACES = 3, 4


class Place(NamedTuple):
    """Where the flights are: height of their start above mean sea level [m], density [kg/m^3] and
    gravity [m/s^2] there; whether pressure falls linearly with height, rho g h, or as the standard
    atmosphere's; and by how much a sample of the GPS position's error forgets the one before."""

    start_alt_m: float
    density_kgpm3: float
    gravity_mps2: float
    linear: bool
    forgets: float


@inlined
def _pressure_at(height_m: float, home_m: float, place: Place) -> float:
    """Static pressure [Pa] at a height above ground; `home_m` is the ground's above sea level."""
    if place.linear:
        ground, _, _ = standard_air(home_m)
        return ground - place.density_kgpm3 * place.gravity_mps2 * height_m
    pressure, _, _ = standard_air(home_m + height_m)
    return pressure


@compiled
def sense_static(buf: Buffer, place: Place) -> None:
    """Static pressure with noise number 1, a constant bias and a drift with the temperature."""
    for lane in range(L):
        # Each flight starts at the same height above the sea, its ground lies below.
        home_m = place.start_alt_m + buf[START + lane]
        height_m = -buf[NOW + DOWN * L + lane]
        _, kelvin, _ = standard_air(home_m + height_m)
        error = buf[BIAS + lane] + buf[DRIFT + lane] * (kelvin - SEA_LEVEL_K)
        noise = buf[SIGMA + lane] * buf[N + L + lane]
        buf[STATIC + lane] = _pressure_at(height_m, home_m, place) + error + noise


@compiled
def sense_place(buf: Buffer, generators: NDArray[np.uint64], place: Place, first: bool) -> None:
    """Position (north, east, down) with Gauss-Markov errors; a lost message is lost as a whole.

    Beard and McLain, Small Unmanned Aircraft, 2012, section 7.5. The `first` error is drawn from
    the stationary distribution.
    """
    draw(buf, generators)
    settled = 1.0 / math.sqrt(1.0 - place.forgets * place.forgets)
    for i in range(3):
        for lane in range(L):
            kick = buf[KICK + i * L + lane] * buf[N + i * L + lane]
            before = buf[ERROR + i * L + lane]
            error = kick * settled if first else place.forgets * before + kick
            buf[ERROR + i * L + lane] = error
            lost = buf[VELOCITY + lane] != buf[VELOCITY + lane]
            place_m = buf[NOW + i * L + lane] + error
            buf[PLACE + i * L + lane] = np.nan if lost else place_m


@compiled
def score_pressures(buf: Buffer, place: Place) -> None:
    """Errors of height and airspeed as the pressures give them."""
    for lane in range(L):
        alive = buf[ALIVE + lane] > 0.5
        home_m = place.start_alt_m + buf[START + lane]
        pressure = max(buf[STATIC + lane], 1.0)
        if place.linear:
            ground, _, _ = standard_air(home_m)
            height_m = (ground - pressure) / (place.density_kgpm3 * place.gravity_mps2)
        else:
            height_m = pressure_altitude(pressure) - home_m
        off_m = height_m + buf[NOW + DOWN * L + lane]
        dynamic = max(buf[PITOT + lane], 0.0)
        u, v, w = air_velocity(buf, lane)
        square = u * u + v * v + w * w
        off_mps = math.sqrt(2.0 * dynamic / place.density_kgpm3) - math.sqrt(square)
        buf[SCORES + HEIGHT * L + lane] += off_m * off_m if alive else 0.0
        buf[SCORES + AIRSPEED * L + lane] += off_mps * off_mps if alive else 0.0
        buf[SCORES + PRESSURES * L + lane] += 1.0 if alive else 0.0


@compiled
def score_place(buf: Buffer) -> None:
    """The error of the GPS position where there is one."""
    for lane in range(L):
        square = 0.0
        for i in range(3):
            off_m = buf[PLACE + i * L + lane] - buf[NOW + i * L + lane]
            square += off_m * off_m
        scored = (buf[ALIVE + lane] > 0.5) & (square == square)
        buf[SCORES + POSITION * L + lane] += square if scored else 0.0
        buf[SCORES + PLACES * L + lane] += 1.0 if scored else 0.0
