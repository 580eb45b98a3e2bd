"""The air: standard atmosphere, steady wind with shear, and Dryden gusts.

Sources: ICAO Doc 7488 (standard atmosphere to 20 km); MIL-F-8785C (Dryden spectra); turbulence
intensities from Beard and McLain, Small Unmanned Aircraft, 2012, table 4.1.
"""

import math

import msgspec

from mavproxy_fault.documents.document_check import NotNegative, Positive
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import to_ned
from simvehicle.vehicles.rigidbody_kernel import E0, E1, E2, E3

SEA_LEVEL_PA = 101325.0
SEA_LEVEL_K = 288.15
_LAPSE_KPM = 0.0065
_GAS_CONSTANT = 287.05287  # J/(kg K)
_EARTH_RADIUS_M = 6356766.0  # Earth radius of the geopotential height
_TROPOPAUSE_M = 11000.0
_SLOWEST_MPS = 1.0  # floor of the airspeed in the gust filters; chosen for hover


@inlined
def standard_air(alt_msl_m: float) -> tuple[float, float, float]:
    """Pressure [Pa], temperature [K] and density [kg/m^3] at a height above mean sea level."""
    # The standard atmosphere is defined over geopotential height.
    h = _EARTH_RADIUS_M * alt_msl_m / (_EARTH_RADIUS_M + alt_msl_m)
    exponent = STANDARD_GRAVITY_MPS2 / (_GAS_CONSTANT * _LAPSE_KPM)
    if h < _TROPOPAUSE_M:
        temperature = SEA_LEVEL_K - _LAPSE_KPM * h
        pressure = SEA_LEVEL_PA * (temperature / SEA_LEVEL_K) ** exponent
    else:
        temperature = SEA_LEVEL_K - _LAPSE_KPM * _TROPOPAUSE_M
        # Above the tropopause the temperature is constant and pressure falls exponentially.
        edge = SEA_LEVEL_PA * (temperature / SEA_LEVEL_K) ** exponent
        pressure = edge * math.exp(
            -STANDARD_GRAVITY_MPS2 * (h - _TROPOPAUSE_M) / (_GAS_CONSTANT * temperature)
        )
    return pressure, temperature, pressure / (_GAS_CONSTANT * temperature)


@inlined
def pressure_altitude(pressure_pa: float) -> float:
    """Height above mean sea level [m] at which the standard troposphere has this pressure."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, _GAS_CONSTANT * _LAPSE_KPM / STANDARD_GRAVITY_MPS2)
    h = (1.0 - ratio) * SEA_LEVEL_K / _LAPSE_KPM
    return _EARTH_RADIUS_M * h / (_EARTH_RADIUS_M - h)


class Gusts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Dryden turbulence along the body axes: standard deviations and length scales."""

    sigma_mps: tuple[NotNegative, NotNegative, NotNegative]
    length_m: tuple[Positive, Positive, Positive]


# Start of the second-order filters in `filters`
LATERAL_FILTER, VERTICAL_FILTER = 1, 3
GUST_FILTERS = GUST_DRAWS = 5
# Start of each item in `weather`, and its length
SIGMA, LENGTH, REFERENCE, EXPONENT, STEADY_WIND, LAW_SIZE = 0, 3, 6, 7, 8, 11

GUST_LEVELS = {
    "none": Gusts((0.0, 0.0, 0.0), (200.0, 200.0, 50.0)),
    "light": Gusts((1.06, 1.06, 0.7), (200.0, 200.0, 50.0)),
    "moderate": Gusts((2.12, 2.12, 1.4), (200.0, 200.0, 50.0)),
    "light-600m": Gusts((1.5, 1.5, 1.5), (533.0, 533.0, 533.0)),
    "moderate-600m": Gusts((3.0, 3.0, 3.0), (533.0, 533.0, 533.0)),
}


@inlined
def _step_lateral_filter(x: Array, a: float, sigma: float, dt: float, noise: Array) -> float:
    """Step the lateral Dryden filter with the states x (2,) exactly, in place; returns the gust.

    H(s) = sigma sqrt(3 a) (s + a / sqrt(3)) / (s + a)^2 for white noise of unit density, a = V / L;
    `noise` (2,) holds standard normal draws.
    """
    e = math.exp(-a * dt)
    ad = a * dt
    q11 = (1.0 - e * e) / (2.0 * a)
    q12 = (1.0 - e * e * (1.0 + 2.0 * ad)) / (4.0 * a * a)
    q22 = (1.0 - e * e * (1.0 + 2.0 * ad + 2.0 * ad * ad)) / (4.0 * a * a * a)
    # The Cholesky factor of the covariance, as the noise of both states is correlated.
    l11 = math.sqrt(q11)
    l21 = q12 / l11
    l22 = math.sqrt(max(q22 - l21 * l21, 0.0))
    x[1] = e * (x[1] + dt * x[0]) + l21 * noise[0] + l22 * noise[1]
    x[0] = e * x[0] + l11 * noise[0]
    gust: float = sigma * math.sqrt(3.0 * a) * (x[0] + (a / math.sqrt(3.0) - a) * x[1])
    return gust


@compiled
def step_wind(
    filters: Array,
    noise: Array,
    weather: Array,
    x: Array,
    v_air: Array,
    height: float,
    dt: float,
    out: Array,
) -> None:
    """Compute the wind of the next `dt` seconds and step the gust filters.

    Parameters
    ----------
    filters : array, shape (5,)
        States, updated in place; initialise the first with a standard normal draw, the rest with
        zeros.
    noise : array, shape (5,)
        Standard-normal draws of this step.
    weather : array, shape (11,)
        Standard deviations (3) [m/s] and length scales (3) [m] of the gusts, reference height [m]
        and exponent of the wind shear's power law, and the wind (3) at that height, NED [m/s].
    x : array, shape (>= 10,)
        The vehicle's state; the gusts act along the body axes.
    v_air : array, shape (3,)
        Velocity through the frozen turbulence [m/s].
    height : float
        Above ground [m].
    out : array, shape (3,)
        Set to the wind, NED [m/s].
    """
    airspeed = math.sqrt(v_air[0] * v_air[0] + v_air[1] * v_air[1] + v_air[2] * v_air[2])
    # Frozen turbulence (Taylor): gusts vary in time with the speed through them.
    speed = max(airspeed, _SLOWEST_MPS)
    e = math.exp(-speed / weather[LENGTH] * dt)
    filters[0] = e * filters[0] + math.sqrt(1.0 - e * e) * noise[0]
    rate = speed / weather[LENGTH + 1]
    v = _step_lateral_filter(
        filters[LATERAL_FILTER:VERTICAL_FILTER],
        rate,
        weather[SIGMA + 1],
        dt,
        noise[LATERAL_FILTER:VERTICAL_FILTER],
    )
    rate = speed / weather[LENGTH + 2]
    w = _step_lateral_filter(
        filters[VERTICAL_FILTER:], rate, weather[SIGMA + 2], dt, noise[VERTICAL_FILTER:]
    )
    u = weather[SIGMA] * filters[0]
    north, east, down = to_ned(x[E0], x[E1], x[E2], x[E3], u, v, w)
    reference = weather[REFERENCE]
    # The floor avoids zero wind at the ground.
    shear = (max(height, 0.01 * reference) / reference) ** weather[EXPONENT]
    out[0] = weather[STEADY_WIND] * shear + north
    out[1] = weather[STEADY_WIND + 1] * shear + east
    out[2] = weather[STEADY_WIND + 2] * shear + down
