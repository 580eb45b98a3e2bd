"""A simple GPS receiver without raw observations: a fix with Gauss-Markov position error.

Model: Beard and McLain, Small Unmanned Aircraft, 2012, section 7.5.
"""

import math
from typing import ClassVar

import numpy as np

from mavproxy_fault.documents.document_check import Section
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.earth import curvature_radii
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.readings import GpsReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


class GpsError(Section, frozen=True):
    """Gauss-Markov position error: nu[n+1] = exp(-k T) nu[n] + eta, eta of `kick_m` per sample."""

    kick_m: float
    k_per_s: float = 1.0 / 1100.0  # of the book: a correlation time of 18 minutes

    def noise(self, rate_hz: float) -> NoiseModel:
        """The Gauss-Markov process as parameters of the shared error model."""
        # Beard and McLain give the noise per sample; convert it to the stationary sigma.
        phi = math.exp(-self.k_per_s / rate_hz)
        sigma = self.kick_m / math.sqrt(1.0 - phi * phi)
        return NoiseModel(drift_sigma=sigma, drift_time_s=1.0 / self.k_per_s)


class Gps(SensorParameters, frozen=True, kw_only=True):
    """Measures position and velocity, and reports the quality fields of HIL_GPS."""

    channels: ClassVar = {"horizontal": 2, "vertical": 1, "velocity": 3}

    rate_hz: Rate = 5.0
    horizontal: GpsError = GpsError(kick_m=0.0)
    vertical: GpsError = GpsError(kick_m=0.0)
    velocity: NoiseModel = NoiseModel()
    satellites: int = 10
    eph_m: float = 1.0
    epv_m: float = 1.5

    def noise_model(self, name: str) -> NoiseModel:
        """The noise model of that name; the position's is a Gauss-Markov process."""
        error: NoiseModel | GpsError = getattr(self, name)
        return error.noise(self.rate_hz) if isinstance(error, GpsError) else error

    def measure(self, truth: Truth, *errors: list[float]) -> GpsReading:
        """One solution."""
        place = np.array([truth.lat_rad, truth.lon_rad, truth.height_m, truth.alt_msl_m])
        fix = self.fixes(place, truth.v_ned_mps, np.hstack(errors)).tolist()
        lat_deg, lon_deg, alt_m, north_mps, east_mps, down_mps = fix
        return GpsReading(
            truth.t_us,
            lat_deg,
            lon_deg,
            alt_m,
            (north_mps, east_mps, down_mps),
            3,  # MAVLink's fix_type: three-dimensional
            self.satellites,
            self.eph_m,
            self.epv_m,
            self.id,
        )

    def fixes(self, place: Array, v_ned_mps: Array, errors: Array) -> Array:
        """Latitude, longitude [deg], height above mean sea level [m] and velocity, (6,) or (6, n).

        `place` (4, ...) are latitude and longitude [rad], height above the ellipsoid and above mean
        sea level [m]; `errors` (6, ...) of north, east, up [m] and velocity.
        """
        lat, lon, height_m, alt_m = place
        north, east, up = errors[:3]
        # Convert metres of error to radians on the ellipsoid, at the vehicle's height.
        meridian, prime = curvature_radii(lat)
        return np.stack(
            [
                np.degrees(lat + north / (meridian + height_m)),
                np.degrees(lon + east / ((prime + height_m) * np.cos(lat))),
                alt_m + up,
                *((1.0 + self.velocity.scale) * v_ned_mps + errors[3:]),
            ]
        )
