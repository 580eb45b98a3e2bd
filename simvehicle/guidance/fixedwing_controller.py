"""A plain autopilot for the fixed wing: path following, height and speed, attitude.

It works on the true state, as it is there to fly missions without an autopilot, not to be tested.
Lateral guidance is the vector field of Beard and McLain, Small Unmanned Aircraft, 2012, chapter
10, with the curvature of the path fed forward; the attitude gains follow from the airframe's
coefficients at the airspeed of the moment (chapter 6 of the same book).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from simvehicle.guidance.route import CircleTrack, GuidanceSetpoint, GuidanceTrack, PathTrack
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.trim import TrimPoint

_PITCH_LIMIT = math.radians(20.0)
_HEIGHT_GAIN = 0.25  # 1/s, height error to climb rate
_CLIMB_LIMIT = 0.12  # climb rate over airspeed
_WINGS_LEVEL_M, _FULL_BANK_M = 3.0, 18.0  # heights of wings level and of full bank
_SINK_MPS, _FLARE_MPS, _FLARE_M = 1.5, 0.5, 6.0


@dataclass(slots=True)
class _Integrals:
    """The integrals of the loops."""

    pitch: float = 0.0
    speed: float = 0.0
    climb: float = 0.0
    bank: float = 0.0


class WingMotion(NamedTuple):
    """Roll, pitch [rad], body rates [rad/s], sideways and whole airspeed [m/s], dynamic pressure
    times area [N]."""

    roll: float
    pitch: float
    p: float
    q: float
    r: float
    v: float
    airspeed: float
    qs: float


class FixedWingController:
    """Flies a track; `track` and `landing` may be changed at any time.

    On the ground it takes off straight ahead; to land it sinks along its track, levels the wings
    near the ground, flares and rolls out.
    """

    rate_hz: float = 50.0
    drifts: bool = True  # it holds its airspeed, so wind carries it through turns
    lateral_mps2: float = STANDARD_GRAVITY_MPS2 * math.tan(math.radians(35.0))
    course_gain = 1.2  # 1/s, course error to turn rate
    track_gain = 0.35  # 1/s, cross-track error to closing speed
    bank_limit = math.radians(50.0)
    roll_lag_s = 0.5  # bank command to bank

    def __init__(self, vehicle: FixedWing, density: float, home_alt_m: float) -> None:
        self.vehicle = vehicle
        self.home_alt_m = home_alt_m
        self.track: GuidanceTrack | None = None
        self.landing = False
        self._density = density
        self._trims: dict[float, TrimPoint] = {}
        self._integrals = _Integrals()

    def trim(self, speed_mps: float) -> TrimPoint:
        """Trim at this speed, kept for later; a speed that cannot be flown becomes the cruise's."""
        if speed_mps not in self._trims:
            try:
                found = self.vehicle.trim(speed_mps, self._density, STANDARD_GRAVITY_MPS2)
            except ValueError:
                cruise = self.vehicle.parameters.cruise_mps
                found = self.vehicle.trim(cruise, self._density, STANDARD_GRAVITY_MPS2)
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
            end = self.track.setpoint_from(north, east, 0.0)
            wait = self.circle(north, east, end.height_m, end.speed_mps)
            # The centre lies to the right of the course, so that the vehicle is on the circle
            # already.
            course, radius = math.atan2(ve, vn), wait.radius_m
            wait.north_m -= radius * math.sin(course)
            wait.east_m += radius * math.cos(course)
            self.track = wait
        ground_speed = max(math.hypot(vn, ve), 1.0)
        aim = self.track.setpoint_from(north, east, ground_speed * self.roll_lag_s)
        if self.landing and truth.on_ground:
            return Controls(np.zeros(4))
        # Close to the ground a bank would put a wing tip into it.
        room = max(
            0.0, min(1.0, (truth.height_agl_m - _WINGS_LEVEL_M) / (_FULL_BANK_M - _WINGS_LEVEL_M))
        )
        limit = self.bank_limit * room
        bank = max(-limit, min(limit, self._bank(aim, math.atan2(ve, vn), ground_speed)))
        return self._attitude(truth, aim, bank, -vd)

    def _bank(self, aim: GuidanceSetpoint, course: float, ground_speed: float) -> float:
        """Bank angle that brings the vehicle onto the track [rad]."""
        approach = self.track_gain * aim.cross_track_m / ground_speed
        wanted = aim.course_rad - math.asin(max(-0.95, min(0.95, approach)))
        error = math.remainder(wanted - course, 2.0 * math.pi)
        # Only motion along the track has to follow its bend.
        along = ground_speed * max(0.0, math.cos(aim.course_rad - course))
        lateral = aim.curvature_pm * along * along + self.course_gain * ground_speed * error
        return math.atan(lateral / STANDARD_GRAVITY_MPS2)

    def _attitude(self, truth: Truth, aim: GuidanceSetpoint, bank: float, climb: float) -> Controls:
        """Surfaces and throttle for a bank angle, a height and a speed."""
        point = self.trim(aim.speed_mps)
        now = self._now(truth, point)
        wanted = self._climb_rate(truth, aim, now)
        pitch = self._pitch(truth, point, now, wanted, climb)
        throw_e, throw_a, throw_r = self.vehicle.throw_rad
        values = [
            self._elevator(point, now, pitch) / throw_e,
            self._aileron(point, now, bank) / throw_a,
            self._rudder(now) / throw_r,
        ]
        clipped = [max(-1.0, min(1.0, value)) for value in values]
        throttle = self._throttle(point, now, wanted)
        if self.landing and truth.height_agl_m < _FLARE_M:
            throttle *= 0.5
        return Controls(np.array([*clipped, max(0.0, min(1.0, throttle))]))

    def _now(self, truth: Truth, point: TrimPoint) -> WingMotion:
        roll, pitch, _ = euler_angles(truth.q_nb.tolist())
        p, q, r = truth.omega_b_rps.tolist()
        u, v, w = truth.v_air_b_mps.tolist()
        # Gains are divided by the airspeed, which is zero on the runway.
        airspeed = max(math.sqrt(u * u + v * v + w * w), 0.5 * point.airspeed_mps)
        area = self.vehicle.parameters.wing.area_m2
        qs = 0.5 * truth.density_kgpm3 * airspeed * airspeed * area
        return WingMotion(roll, pitch, p, q, r, v, airspeed, qs)

    def _climb_rate(self, truth: Truth, aim: GuidanceSetpoint, now: WingMotion) -> float:
        """Climb rate that closes the height error, or the sink rate of a landing [m/s]."""
        if self.landing:
            return -_SINK_MPS if truth.height_agl_m > _FLARE_M else -_FLARE_MPS
        error = aim.height_m - (truth.alt_msl_m - self.home_alt_m)
        limit = _CLIMB_LIMIT * now.airspeed
        return max(-limit, min(limit, _HEIGHT_GAIN * error))

    def _pitch(
        self, truth: Truth, point: TrimPoint, now: WingMotion, wanted: float, climb: float
    ) -> float:
        """Pitch for a climb rate; the angle of attack that carries the turn is fed forward."""
        aero, integrals = self.vehicle.aero, self._integrals
        # At the limit of the climb rate, or on the ground, the integral would only wind up.
        if abs(wanted) < _CLIMB_LIMIT * now.airspeed and not truth.on_ground:
            integrals.climb += 0.15 * (wanted - climb) / now.airspeed / self.rate_hz
        integrals.climb = max(-0.15, min(0.15, integrals.climb))
        load = 1.0 / max(0.5, math.cos(now.roll))
        lift = load * self.vehicle.parameters.mass_kg * STANDARD_GRAVITY_MPS2 / now.qs
        alpha = (lift - aero.cl0 - aero.clde * point.elevator_rad) / aero.cla
        pitch = min(0.3, alpha) + wanted / now.airspeed + integrals.climb
        return max(-_PITCH_LIMIT, min(_PITCH_LIMIT, pitch))

    def _elevator(self, point: TrimPoint, now: WingMotion, pitch: float) -> float:
        """Deflection [rad] that doubles the airframe's own pitch stiffness and adds damping."""
        aero, integrals, inverse = self.vehicle.aero, self._integrals, self.vehicle.body.inverse_jy
        chord = self.vehicle.parameters.wing.chord_m
        own = -now.qs * chord * aero.cma * inverse
        power = now.qs * chord * aero.cmde * inverse
        damping = -0.5 * now.qs * chord * chord * aero.cmq / now.airspeed * inverse
        added = max(own, 20.0)
        lack = max(0.0, 1.4 * math.sqrt(max(0.0, own + added)) - damping)
        integrals.pitch += 0.5 * added * (pitch - now.pitch) / self.rate_hz
        integrals.pitch = max(-10.0, min(10.0, integrals.pitch))
        turning = STANDARD_GRAVITY_MPS2 / now.airspeed * math.tan(now.roll) * math.sin(now.roll)
        moment = added * (pitch - now.pitch) + integrals.pitch - lack * (now.q - turning)
        return moment / power + point.elevator_rad

    def _aileron(self, point: TrimPoint, now: WingMotion, bank: float) -> float:
        """Deflection [rad] for a bank angle."""
        aero, body, integrals = self.vehicle.aero, self.vehicle.body, self._integrals
        span = self.vehicle.parameters.wing.span_m
        gain = 0.5 * now.qs * span * span / now.airspeed
        damping = -gain * (body.g3 * aero.crp + body.g4 * aero.cnp)
        power = now.qs * span * (body.g3 * aero.crda + body.g4 * aero.cnda)
        stiff = max(25.0, 3.5 * damping)
        lack = max(0.0, 1.4 * math.sqrt(stiff) - damping)
        integral = integrals.bank + 0.3 * (bank - now.roll) / self.rate_hz
        integrals.bank = max(-0.3, min(0.3, integral))
        return (stiff * (bank + integrals.bank - now.roll) - lack * now.p) / power

    def _rudder(self, now: WingMotion) -> float:
        """Deflection [rad] that damps yaw about the rate of a coordinated turn."""
        aero, body = self.vehicle.aero, self.vehicle.body
        span = self.vehicle.parameters.wing.span_m
        power = now.qs * span * (body.g4 * aero.crdr + body.g8 * aero.cndr)
        turning = STANDARD_GRAVITY_MPS2 / now.airspeed * math.sin(now.roll)
        return -(now.r - turning) / power if abs(power) > 1e-6 else 0.0

    def _throttle(self, point: TrimPoint, now: WingMotion, wanted: float) -> float:
        """Throttle for the airspeed and the climb rate."""
        short = point.airspeed_mps - now.airspeed
        integral = self._integrals.speed + 0.02 * short / self.rate_hz
        self._integrals.speed = max(-0.5, min(0.5, integral))
        return point.throttle + 0.1 * short + self._integrals.speed + 1.5 * wanted / now.airspeed
