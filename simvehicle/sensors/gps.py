"""A simple GPS receiver without raw observations: a fix with Gauss-Markov position error.

Model: Beard and McLain, Small Unmanned Aircraft, 2012, section 7.5.
"""

import math
from typing import ClassVar

import msgspec

from mavproxy_fault.numerics.earth import curvature_radii
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.readings import GpsReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


class GpsError(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
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
        (north, east), (up,), speed = errors
        # Convert metres of error to radians on the ellipsoid, at the vehicle's height.
        meridian, prime = curvature_radii(truth.lat_rad)
        vn, ve, vd = truth.v_ned_mps.tolist()
        gain = 1.0 + self.velocity.scale
        lat = truth.lat_rad + north / (float(meridian) + truth.height_m)
        lon = truth.lon_rad + east / ((float(prime) + truth.height_m) * math.cos(truth.lat_rad))
        return GpsReading(
            truth.t_us,
            math.degrees(lat),
            math.degrees(lon),
            truth.alt_msl_m + up,
            (gain * vn + speed[0], gain * ve + speed[1], gain * vd + speed[2]),
            3,  # MAVLink's fix_type: three-dimensional
            self.satellites,
            self.eph_m,
            self.epv_m,
            self.id,
        )
