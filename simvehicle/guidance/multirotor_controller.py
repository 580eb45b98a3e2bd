"""The built-in controller of the multirotor: path following, height, attitude, motor mixing.

It uses the true state: its purpose is to fly missions without an autopilot, not to be tested.
Velocity errors give an acceleration setpoint, that an attitude and thrust setpoint (Mellinger and
Kumar, ICRA 2011), and those the motor commands by the pseudoinverse of the rotor geometry.
"""

import math

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned
from simvehicle.guidance.route import GuidanceTrack, HoldTrack, PathTrack, Setpoint
from simvehicle.sensors.readings import Triple
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.solution import round_solution

_TRACK_GAIN = 1.0  # 1/s, cross-track error to closing speed
_SPEED_GAIN = 2.5  # 1/s, velocity error to acceleration
_INTEGRAL_GAIN = 0.8  # 1/s^2
_HEIGHT_GAIN = 1.2  # 1/s
# Speeds as in PX4: MPC_Z_VEL_MAX_UP, somewhat faster than MPC_Z_VEL_MAX_DN, MPC_LAND_SPEED
_CLIMB_MPS, _SINK_MPS = 3.0, 2.0
_LANDING_MPS = 0.7
# Horizontal acceleration limit, 35 degrees of tilt
_HORIZONTAL_ACCEL_MPS2 = 0.7 * STANDARD_GRAVITY_MPS2
_YAW_RATE_RPS = 1.0  # chosen: yaw takes little of the motors' range
_ATTITUDE_GAIN = 8.0  # 1/s
_RATE_GAIN = 22.0  # 1/s
_CLIMB_FIRST_M = 2.0  # height range over which horizontal speed increases after take-off
_LANDING_RADIUS_M = 1.0  # horizontal distance within which it descends to land
_TURN_LEAD_S = 0.15  # chosen: about the lag of the attitude


@inlined
def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _unit(v: Triple) -> Triple:
    size = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return v[0] / size, v[1] / size, v[2] / size


@compiled
def _motor_commands(
    q: Array,
    rates: Array,
    accel: Triple,
    yaw: float,
    body: Array,
    allocation: Array,
    limits: Triple,
    out: Array,
) -> None:
    """Fill in commands (n,) for an acceleration setpoint (NED, without gravity) and a heading.

    `body` is mass and jx, jy, jz; `allocation` (n, 4) maps thrust and moments to rotor thrusts;
    `limits` is the thrust coefficient at this density, idle and full speed [rad/s].
    """
    # Down axis of the attitude setpoint
    push = (-accel[0], -accel[1], STANDARD_GRAVITY_MPS2 - accel[2])
    size = math.sqrt(push[0] ** 2 + push[1] ** 2 + push[2] ** 2)
    z = _unit(push)
    x = _unit(_cross((-math.sin(yaw), math.cos(yaw), 0.0), z))
    y = _cross(z, x)
    # The attitude error, in body axes: half the antisymmetric part of R^T R_setpoint.
    now_z = to_ned(q[0], q[1], q[2], q[3], 0.0, 0.0, 1.0)
    a = _cross(to_ned(q[0], q[1], q[2], q[3], 1.0, 0.0, 0.0), x)
    b = _cross(to_ned(q[0], q[1], q[2], q[3], 0.0, 1.0, 0.0), y)
    c = _cross(now_z, z)
    error = (0.5 * (a[0] + b[0] + c[0]), 0.5 * (a[1] + b[1] + c[1]), 0.5 * (a[2] + b[2] + c[2]))
    error_b = to_body(q[0], q[1], q[2], q[3], error[0], error[1], error[2])
    along = max(0.3, now_z[0] * z[0] + now_z[1] * z[1] + now_z[2] * z[2])
    for i in range(allocation.shape[0]):
        thrust = allocation[i, 0] * body[0] * size * along
        for axis in range(3):
            gain = 1.0 if axis < 2 else 0.3  # yaw has the lowest priority
            rate = gain * _ATTITUDE_GAIN * error_b[axis]
            moment = body[1 + axis] * gain * _RATE_GAIN * (rate - rates[axis])
            thrust += allocation[i, 1 + axis] * moment
        speed = math.sqrt(max(thrust, 0.0) / limits[0])
        out[i] = min(1.0, max(0.01, (speed - limits[1]) / (limits[2] - limits[1])))


class MultirotorController:
    """Flies a track; `track`, `landing` and `yaw_rad` may be changed at any time."""

    rate_hz: float = 125.0
    drifts: bool = False  # it flies at constant speed over ground
    lateral_mps2: float = 3.0

    def __init__(self, vehicle: Multirotor, home_alt_m: float) -> None:
        self.vehicle = vehicle
        self.home_alt_m = home_alt_m
        self.track: GuidanceTrack | None = None
        self.landing = False
        self.yaw_rad = math.nan
        self._heading: float | None = None
        self._integral = [0.0, 0.0, 0.0]
        moments = vehicle.parameters.inertia_kgm2
        self._body = np.array([vehicle.parameters.mass_kg, moments.jx, moments.jy, moments.jz])
        allocation = round_solution(np.linalg.pinv(vehicle.thrust_effects))
        self._allocation = np.ascontiguousarray(allocation)

    def circle(
        self, north_m: float, east_m: float, height_m: float, speed_mps: float
    ) -> GuidanceTrack:
        """A track that flies to a point and hovers there."""
        return HoldTrack(north_m, east_m, height_m, speed_mps)

    def update(self, truth: Truth) -> Controls:
        """Controls for the next control period."""
        if self.landing and truth.on_ground:
            self._integral = [0.0, 0.0, 0.0]
            return Controls(np.zeros(self.vehicle.controls_count))
        north, east, _ = truth.r_ned_m.tolist()
        height = truth.alt_msl_m - self.home_alt_m
        if self.track is None:
            self.track = self.circle(north, east, height, self.vehicle.parameters.cruise_mps)
        if isinstance(self.track, PathTrack) and self.track.finished:
            end = self.track.setpoint_from(north, east, 0.0)
            self.track = self.circle(north, east, end.height_m, end.speed_mps)
        vn, ve, vd = truth.v_ned_mps.tolist()
        setpoint = self.track.setpoint_from(north, east, math.hypot(vn, ve) * _TURN_LEAD_S)
        # Near the ground it climbs first, unless it is already at the height of the setpoint.
        ahead_scale = max(0.0, min(1.0, (truth.height_agl_m - 1.0) / _CLIMB_FIRST_M))
        if setpoint.height_m - height < 0.5 or self.landing:
            ahead_scale = 1.0
        accel = self._acceleration(setpoint, height, (vn, ve, vd), ahead_scale)
        yaw = self._yaw(setpoint, truth)
        motor = self.vehicle.parameters.motor
        thrust = motor.thrust_n_per_rps2 * truth.density_kgpm3 / SEA_LEVEL_DENSITY_KGPM3
        values = np.empty(self.vehicle.controls_count)
        _motor_commands(
            truth.q_nb,
            truth.omega_b_rps,
            accel,
            yaw,
            self._body,
            self._allocation,
            (thrust, motor.idle_rps, motor.full_rps),
            values,
        )
        return Controls(values)

    def _acceleration(
        self,
        setpoint: Setpoint,
        height: float,
        velocity: tuple[float, float, float],
        ahead_scale: float,
    ) -> Triple:
        """Acceleration setpoint without gravity, NED [m/s^2]; `ahead_scale` is 0 to 1."""
        c, s = math.cos(setpoint.course_rad), math.sin(setpoint.course_rad)
        closing = max(
            -setpoint.speed_mps - 1.0,
            min(setpoint.speed_mps + 1.0, _TRACK_GAIN * setpoint.cross_track_m),
        )
        climb = _HEIGHT_GAIN * (setpoint.height_m - height)
        offset = math.hypot(setpoint.cross_track_m, setpoint.distance_m)
        if self.landing and offset < _LANDING_RADIUS_M:
            climb = -_LANDING_MPS if height < 5.0 else -_SINK_MPS
        climb = max(-_SINK_MPS, min(_CLIMB_MPS, climb))
        ahead = setpoint.speed_mps * ahead_scale
        velocity_setpoint = (ahead * c + closing * s, ahead * s - closing * c, -climb)
        bend = setpoint.curvature_pm * setpoint.speed_mps**2
        forward = (-bend * s, bend * c, 0.0)
        dt = 1.0 / self.rate_hz
        out = []
        for axis in range(3):
            error = velocity_setpoint[axis] - velocity[axis]
            if abs(error) < 2.0:  # larger ones are manoeuvres, not disturbances
                integral = self._integral[axis] + _INTEGRAL_GAIN * error * dt
                self._integral[axis] = max(-5.0, min(5.0, integral))
            out.append(_SPEED_GAIN * error + self._integral[axis] + forward[axis])
        size = math.hypot(out[0], out[1])
        scale = min(1.0, _HORIZONTAL_ACCEL_MPS2 / max(size, 1e-9))
        return out[0] * scale, out[1] * scale, max(-6.0, min(6.0, out[2]))

    def _yaw(self, setpoint: Setpoint, truth: Truth) -> float:
        """Heading setpoint: `yaw_rad`, or else along the track, with a limited rate."""
        if self._heading is None:
            self._heading = euler_angles(truth.q_nb.tolist())[2]
        yaw_setpoint = self.yaw_rad
        if not math.isfinite(yaw_setpoint):
            yaw_setpoint = setpoint.course_rad if setpoint.distance_m > 2.0 else self._heading
        heading_error = math.remainder(yaw_setpoint - self._heading, 2.0 * math.pi)
        limit = _YAW_RATE_RPS / self.rate_hz
        self._heading += max(-limit, min(limit, heading_error))
        return self._heading
