"""A plain autopilot for the fixed wing: path following, height and speed, attitude.

It works on the true state, as it is there to fly missions without an autopilot, not to be tested.
Lateral guidance is the vector field of Beard and McLain, Small Unmanned Aircraft, 2012, chapter
10, with the curvature of the path fed forward; the attitude gains follow from the airframe's
coefficients at the airspeed of the moment (chapter 6 of the same book).
"""

import math
from dataclasses import dataclass

import numpy as np

from simvehicle.body import Controls, Truth
from simvehicle.guidance import Aim, CircleTrack, PathTrack, Track
from simvehicle.rotation import euler_angles
from simvehicle.vehicles.fixedwing import FixedWing
from simvehicle.vehicles.trim import Trim

_G = 9.80665
_COURSE_GAIN = 1.2  # 1/s, course error to turn rate
_TRACK_GAIN = 0.35  # 1/s, cross-track error to closing speed
_BANK_LIMIT = math.radians(50.0)
_PITCH_LIMIT = math.radians(20.0)
_ROLL_LAG_S = 0.5  # bank command to bank
_HEIGHT_GAIN = 0.25  # 1/s, height error to climb rate
_CLIMB_LIMIT = 0.12  # climb rate over airspeed
_LEVEL_M, _FREE_M = 3.0, 18.0  # heights of wings level and of full bank
_SINK_MPS, _FLARE_MPS, _FLARE_M = 1.5, 0.5, 6.0


@dataclass(slots=True)
class _Memory:
    """The integrals of the loops."""

    pitch: float = 0.0
    speed: float = 0.0
    climb: float = 0.0
    bank: float = 0.0


class FixedWingController:
    """Flies a track; `track` and `landing` may be changed at any time.

    On the ground it takes off straight ahead; to land it sinks along its track, levels the wings
    near the ground, flares and rolls out.
    """

    rate_hz = 50.0
    drifts = True  # it holds its airspeed, so wind carries it through turns
    lateral_mps2 = _G * math.tan(math.radians(35.0))

    def __init__(self, vehicle: FixedWing, density: float, home_alt_m: float) -> None:
        self.vehicle = vehicle
        self.home_alt_m = home_alt_m
        self.track: Track | None = None
        self.landing = False
        self._density = density
        self._trims: dict[float, Trim] = {}
        self._memory = _Memory()

    def trim(self, speed_mps: float) -> Trim:
        """Trim at this speed, kept for later; a speed that cannot be flown becomes the cruise's."""
        if speed_mps not in self._trims:
            try:
                found = self.vehicle.trim(speed_mps, self._density, _G)
            except ValueError:
                cruise = self.vehicle.parameters.cruise_mps
                found = self.vehicle.trim(cruise, self._density, _G)
            self._trims[speed_mps] = found
        return self._trims[speed_mps]

    def circle(
        self, north_m: float, east_m: float, height_m: float, speed_mps: float
    ) -> CircleTrack:
        """A track that waits at a point."""
        radius = 1.3 * speed_mps**2 / self.lateral_mps2
        return CircleTrack(north_m, east_m, height_m, radius, speed_mps)

    def update(self, truth: Truth) -> Controls:
        """Controls for the next control period."""
        north, east, _ = truth.r_ned_m.tolist()
        if self.track is None:
            cruise = self.vehicle.parameters.cruise_mps
            self.track = self.circle(north, east, truth.alt_msl_m - self.home_alt_m, cruise)
        vn, ve, vd = truth.v_ned_mps.tolist()
        if isinstance(self.track, PathTrack) and self.track.finished:
            end = self.track.look(north, east, 0.0)
            wait = self.circle(north, east, end.height_m, end.speed_mps)
            course, radius = math.atan2(ve, vn), wait.radius_m
            wait.north_m -= radius * math.sin(course)
            wait.east_m += radius * math.cos(course)
            self.track = wait
        ground_speed = max(math.hypot(vn, ve), 1.0)
        aim = self.track.look(north, east, ground_speed * _ROLL_LAG_S)
        if self.landing and truth.on_ground:
            return Controls(np.zeros(4))
        room = max(0.0, min(1.0, (truth.height_agl_m - _LEVEL_M) / (_FREE_M - _LEVEL_M)))
        limit = _BANK_LIMIT * room
        bank = max(-limit, min(limit, self._bank(aim, math.atan2(ve, vn), ground_speed)))
        return self._attitude(truth, aim, bank, -vd)

    def _bank(self, aim: Aim, course: float, ground_speed: float) -> float:
        """Bank angle that brings the vehicle onto the track [rad]."""
        approach = _TRACK_GAIN * aim.cross_track_m / ground_speed
        wanted = aim.course_rad - math.asin(max(-0.95, min(0.95, approach)))
        error = math.remainder(wanted - course, 2.0 * math.pi)
        along = ground_speed * max(0.0, math.cos(aim.course_rad - course))
        lateral = aim.curvature_pm * along * along + _COURSE_GAIN * ground_speed * error
        return math.atan(lateral / _G)

    def _attitude(self, truth: Truth, aim: Aim, bank: float, climb: float) -> Controls:
        """Surfaces and throttle for a bank angle, a height and a speed."""
        dt = 1.0 / self.rate_hz
        par, aero, body = self.vehicle.parameters, self.vehicle.aero, self.vehicle.body
        memory, point = self._memory, self.trim(aim.speed_mps)
        roll, pitch, _ = euler_angles(truth.q_nb)
        p, q, r = truth.omega_b_rps.tolist()
        u, v, w = truth.v_air_b_mps.tolist()
        airspeed = max(math.sqrt(u * u + v * v + w * w), 0.5 * point.airspeed_mps)
        qs = 0.5 * truth.density_kgpm3 * airspeed * airspeed * par.wing.area_m2
        span, chord = par.wing.span_m, par.wing.chord_m

        # Height to climb rate to pitch; the angle of attack that carries the turn is fed forward.
        error = aim.height_m - (truth.alt_msl_m - self.home_alt_m)
        limit = _CLIMB_LIMIT * airspeed
        wanted = max(-limit, min(limit, _HEIGHT_GAIN * error))
        if self.landing:
            wanted = -_SINK_MPS if truth.height_agl_m > _FLARE_M else -_FLARE_MPS
        if abs(wanted) < limit and not truth.on_ground:
            memory.climb += 0.15 * (wanted - climb) / airspeed * dt
        memory.climb = max(-0.15, min(0.15, memory.climb))
        load = 1.0 / max(0.5, math.cos(roll))
        lift = load * par.mass_kg * _G / qs
        alpha = (lift - aero.cl0 - aero.clde * point.elevator_rad) / aero.cla
        pitch_wanted = min(0.3, alpha) + wanted / airspeed + memory.climb
        pitch_wanted = max(-_PITCH_LIMIT, min(_PITCH_LIMIT, pitch_wanted))

        stiffness = -qs * chord * aero.cma * body.inverse_jy
        power = qs * chord * aero.cmde * body.inverse_jy
        damping = -0.5 * qs * chord * chord * aero.cmq / airspeed * body.inverse_jy
        omega2 = max(stiffness, 20.0)
        lack = max(0.0, 1.4 * math.sqrt(stiffness + omega2) - damping)
        memory.pitch += 0.5 * omega2 * (pitch_wanted - pitch) * dt
        memory.pitch = max(-10.0, min(10.0, memory.pitch))
        pitch_rate = _G / airspeed * math.tan(roll) * math.sin(roll)
        elevator = (
            omega2 * (pitch_wanted - pitch) + memory.pitch - lack * (q - pitch_rate)
        ) / power + point.elevator_rad

        damping = -0.5 * qs * span * span / airspeed * (body.g3 * aero.crp + body.g4 * aero.cnp)
        power = qs * span * (body.g3 * aero.crda + body.g4 * aero.cnda)
        stiff = max(25.0, 3.5 * damping)
        lack = max(0.0, 1.4 * math.sqrt(stiff) - damping)
        memory.bank = max(-0.3, min(0.3, memory.bank + 0.3 * (bank - roll) * dt))
        aileron = (stiff * (bank + memory.bank - roll) - lack * p) / power

        power = qs * span * (body.g4 * aero.crdr + body.g8 * aero.cndr)
        turning = _G / airspeed * math.sin(roll)
        rudder = -1.0 * (r - turning) / power if abs(power) > 1e-6 else 0.0

        short = point.airspeed_mps - airspeed
        memory.speed = max(-0.5, min(0.5, memory.speed + 0.02 * short * dt))
        throttle = point.throttle + 0.1 * short + memory.speed + 1.5 * wanted / airspeed
        throw_e, throw_a, throw_r = self.vehicle.throw_rad
        values = [elevator / throw_e, aileron / throw_a, rudder / throw_r]
        clipped = [max(-1.0, min(1.0, value)) for value in values]
        if self.landing and truth.height_agl_m < _FLARE_M:
            throttle *= 0.5
        return Controls(np.array([*clipped, max(0.0, min(1.0, throttle))]))
