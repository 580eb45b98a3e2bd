"""The built-in controller of the fixed wing: path following, height and speed, attitude.

It uses the true state: its purpose is to fly missions without an autopilot, not to be tested.
Lateral guidance is the vector field of Beard and McLain, Small Unmanned Aircraft, 2012, chapter
10, with the path curvature fed forward; the attitude gains follow from the airframe's coefficients
at the current airspeed (chapter 6 of the same book).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from simvehicle.guidance.route import CircleTrack, GuidanceTrack, PathTrack, Setpoint
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.trim import TrimPoint

_PITCH_LIMIT = math.radians(20.0)  # chosen
_HEIGHT_GAIN = 0.25  # 1/s, height error to climb rate
_CLIMB_LIMIT = 0.12  # climb rate over airspeed
_WINGS_LEVEL_M, _FULL_BANK_M = 3.0, 18.0  # heights of level wings and of full bank
_SINK_MPS, _FLARE_MPS, _FLARE_M = 1.5, 0.5, 6.0  # of a landing, and where it flares; chosen


@dataclass(slots=True)
class _Integrals:
    """Integrator states of the control loops."""

    pitch: float = 0.0
    speed: float = 0.0
    climb: float = 0.0
    bank: float = 0.0


class WingMotion(NamedTuple):
    """Roll, pitch [rad], body rates [rad/s], lateral and total airspeed [m/s], dynamic pressure
    times wing area [N]."""

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

    From the ground it takes off straight ahead; to land it descends along its track, levels the
    wings near the ground, flares and rolls out.
    """

    rate_hz: float = 50.0
    drifts: bool = True  # it flies at constant airspeed, so wind displaces its turns
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
        """Trim at this speed, cached; a speed that cannot be flown is replaced by cruise speed."""
        if speed_mps not in self._trims:
            try:
                point = self.vehicle.trim(speed_mps, self._density, STANDARD_GRAVITY_MPS2)
            except ValueError:
                cruise = self.vehicle.parameters.cruise_mps
                point = self.vehicle.trim(cruise, self._density, STANDARD_GRAVITY_MPS2)
            self._trims[speed_mps] = point
        return self._trims[speed_mps]

    def circle(
        self, north_m: float, east_m: float, height_m: float, speed_mps: float
    ) -> CircleTrack:
        """A track that loiters around a point."""
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
            circle = self.circle(north, east, end.height_m, end.speed_mps)
            # Centre to the right of the course: the vehicle is already on the circle.
            course, radius = math.atan2(ve, vn), circle.radius_m
            circle.north_m -= radius * math.sin(course)
            circle.east_m += radius * math.cos(course)
            self.track = circle
        ground_speed = max(math.hypot(vn, ve), 1.0)
        setpoint = self.track.setpoint_from(north, east, ground_speed * self.roll_lag_s)
        if self.landing and truth.on_ground:
            return Controls(np.zeros(4))
        # Near the ground the bank is limited for the wing tips.
        bank_scale = max(
            0.0, min(1.0, (truth.height_agl_m - _WINGS_LEVEL_M) / (_FULL_BANK_M - _WINGS_LEVEL_M))
        )
        limit = self.bank_limit * bank_scale
        bank = max(-limit, min(limit, self._bank(setpoint, math.atan2(ve, vn), ground_speed)))
        return self._attitude(truth, setpoint, bank, -vd)

    def _bank(self, setpoint: Setpoint, course: float, ground_speed: float) -> float:
        """Bank angle that brings the vehicle onto the track [rad]."""
        approach = self.track_gain * setpoint.cross_track_m / ground_speed
        course_setpoint = setpoint.course_rad - math.asin(max(-0.95, min(0.95, approach)))
        error = math.remainder(course_setpoint - course, 2.0 * math.pi)
        # Only motion along the track needs the path's curvature.
        along = ground_speed * max(0.0, math.cos(setpoint.course_rad - course))
        lateral = setpoint.curvature_pm * along * along + self.course_gain * ground_speed * error
        return math.atan(lateral / STANDARD_GRAVITY_MPS2)

    def _attitude(self, truth: Truth, setpoint: Setpoint, bank: float, climb: float) -> Controls:
        """Surfaces and throttle for a bank angle, a height and a speed."""
        point = self.trim(setpoint.speed_mps)
        motion = self._motion(truth, point)
        climb_rate = self._climb_rate(truth, setpoint, motion)
        pitch = self._pitch(truth, point, motion, climb_rate, climb)
        throw_e, throw_a, throw_r = self.vehicle.throw_rad
        values = [
            self._elevator(point, motion, pitch) / throw_e,
            self._aileron(point, motion, bank) / throw_a,
            self._rudder(motion) / throw_r,
        ]
        clipped = [max(-1.0, min(1.0, value)) for value in values]
        throttle = self._throttle(point, motion, climb_rate)
        if self.landing and truth.height_agl_m < _FLARE_M:
            throttle *= 0.5
        return Controls(np.array([*clipped, max(0.0, min(1.0, throttle))]))

    def _motion(self, truth: Truth, point: TrimPoint) -> WingMotion:
        roll, pitch, _ = euler_angles(truth.q_nb.tolist())
        p, q, r = truth.omega_b_rps.tolist()
        u, v, w = truth.v_air_b_mps.tolist()
        # A lower bound: gains are divided by the airspeed, which is zero on the runway.
        airspeed = max(math.sqrt(u * u + v * v + w * w), 0.5 * point.airspeed_mps)
        area = self.vehicle.parameters.wing.area_m2
        qs = 0.5 * truth.density_kgpm3 * airspeed * airspeed * area
        return WingMotion(roll, pitch, p, q, r, v, airspeed, qs)

    def _climb_rate(self, truth: Truth, setpoint: Setpoint, motion: WingMotion) -> float:
        """Climb rate that closes the height error, or the sink rate of a landing [m/s]."""
        if self.landing:
            return -_SINK_MPS if truth.height_agl_m > _FLARE_M else -_FLARE_MPS
        error = setpoint.height_m - (truth.alt_msl_m - self.home_alt_m)
        limit = _CLIMB_LIMIT * motion.airspeed
        return max(-limit, min(limit, _HEIGHT_GAIN * error))

    def _pitch(
        self, truth: Truth, point: TrimPoint, motion: WingMotion, climb_rate: float, climb: float
    ) -> float:
        """Pitch for a climb rate; the angle of attack that the turn needs is fed forward."""
        aero, integrals = self.vehicle.aero, self._integrals
        # Anti-windup: freeze the integral at the climb rate limit and on the ground.
        if abs(climb_rate) < _CLIMB_LIMIT * motion.airspeed and not truth.on_ground:
            integrals.climb += 0.15 * (climb_rate - climb) / motion.airspeed / self.rate_hz
        integrals.climb = max(-0.15, min(0.15, integrals.climb))
        load = 1.0 / max(0.5, math.cos(motion.roll))
        lift = load * self.vehicle.parameters.mass_kg * STANDARD_GRAVITY_MPS2 / motion.qs
        alpha = (lift - aero.cl0 - aero.clde * point.elevator_rad) / aero.cla
        pitch = min(0.3, alpha) + climb_rate / motion.airspeed + integrals.climb
        return max(-_PITCH_LIMIT, min(_PITCH_LIMIT, pitch))

    def _elevator(self, point: TrimPoint, motion: WingMotion, pitch: float) -> float:
        """Deflection [rad] that doubles the airframe's pitch stiffness and adds damping."""
        aero, integrals, inverse = self.vehicle.aero, self._integrals, self.vehicle.body.inverse_jy
        chord = self.vehicle.parameters.wing.chord_m
        stiffness = -motion.qs * chord * aero.cma * inverse
        power = motion.qs * chord * aero.cmde * inverse
        damping = -0.5 * motion.qs * chord * chord * aero.cmq / motion.airspeed * inverse
        added = max(stiffness, 20.0)
        extra_damping = max(0.0, 1.4 * math.sqrt(max(0.0, stiffness + added)) - damping)
        integrals.pitch += 0.5 * added * (pitch - motion.pitch) / self.rate_hz
        integrals.pitch = max(-10.0, min(10.0, integrals.pitch))
        roll = motion.roll
        turning = STANDARD_GRAVITY_MPS2 / motion.airspeed * math.tan(roll) * math.sin(roll)
        moment = (
            added * (pitch - motion.pitch) + integrals.pitch - extra_damping * (motion.q - turning)
        )
        return moment / power + point.elevator_rad

    def _aileron(self, point: TrimPoint, motion: WingMotion, bank: float) -> float:
        """Deflection [rad] for a bank angle."""
        aero, body, integrals = self.vehicle.aero, self.vehicle.body, self._integrals
        span = self.vehicle.parameters.wing.span_m
        gain = 0.5 * motion.qs * span * span / motion.airspeed
        damping = -gain * (body.g3 * aero.crp + body.g4 * aero.cnp)
        power = motion.qs * span * (body.g3 * aero.crda + body.g4 * aero.cnda)
        stiff = max(25.0, 3.5 * damping)
        extra_damping = max(0.0, 1.4 * math.sqrt(stiff) - damping)
        integral = integrals.bank + 0.3 * (bank - motion.roll) / self.rate_hz
        integrals.bank = max(-0.3, min(0.3, integral))
        return (stiff * (bank + integrals.bank - motion.roll) - extra_damping * motion.p) / power

    def _rudder(self, motion: WingMotion) -> float:
        """Deflection [rad] that damps yaw about the rate of a coordinated turn."""
        aero, body = self.vehicle.aero, self.vehicle.body
        span = self.vehicle.parameters.wing.span_m
        power = motion.qs * span * (body.g4 * aero.crdr + body.g8 * aero.cndr)
        turning = STANDARD_GRAVITY_MPS2 / motion.airspeed * math.sin(motion.roll)
        return -(motion.r - turning) / power if abs(power) > 1e-6 else 0.0

    def _throttle(self, point: TrimPoint, motion: WingMotion, climb_rate: float) -> float:
        """Throttle for the airspeed and the climb rate."""
        short = point.airspeed_mps - motion.airspeed
        integral = self._integrals.speed + 0.02 * short / self.rate_hz
        self._integrals.speed = max(-0.5, min(0.5, integral))
        return (
            point.throttle
            + 0.1 * short
            + self._integrals.speed
            + 1.5 * climb_rate / motion.airspeed
        )
