"""Forces and moments of the fixed wing, as scalar compiled functions.

The 12-state nonlinear model of Beard and McLain, Small Unmanned Aircraft, 2012, chapters 3 and 4,
with a quaternion for the attitude.
"""

from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import atan2, exp
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.vehicles.rigidbody_kernel import Inertia, State13, rigid_body_derivative

_REV_PER_RAD = 1.0 / (2.0 * np.pi)
_STILL_AIR_MPS = 1e-9  # m/s; keeps the flow angles defined in still air


class Aero(NamedTuple):
    """Coefficients of the airframe and its propulsion; symbols as in Beard and McLain, table E.1.

    Angles in rad, lengths in m. `direct_current` is 1 for the motor and propeller model of the
    book's later supplement and 0 for the thrust law of the first edition; the terms of the unused
    model have no effect. `blend` is exp(M * alpha0) of the stall blending function.
    """

    s: float
    b: float
    c: float
    cl0: float
    cla: float
    clq: float
    clde: float
    induced: float
    cdp: float
    cdq: float
    cdde: float
    cm0: float
    cma: float
    cmq: float
    cmde: float
    stall_m: float
    blend: float
    cy0: float
    cyb: float
    cyp: float
    cyr: float
    cyda: float
    cydr: float
    cr0: float
    crb: float
    crp: float
    crr: float
    crda: float
    crdr: float
    cn0: float
    cnb: float
    cnp: float
    cnr: float
    cnda: float
    cndr: float
    disc: float
    k_motor: float
    torque: float
    direct_current: float
    diameter: float
    cq0: float
    cq1: float
    cq2: float
    ct0: float
    ct1: float
    ct2: float
    v_max: float
    kq: float
    resistance: float
    i0: float


@inlined
def propulsion_output(
    airspeed: float, throttle: float, density: float, aero: Aero
) -> tuple[float, float, float]:
    """Thrust [N], torque on the airframe [N m] and motor current [A] (0 without a motor model)."""
    # First edition, section 4.3: momentum theory; the throttle commands the exit airspeed.
    square = aero.k_motor * throttle
    simple = 0.5 * density * aero.disc * (square * square - airspeed * airspeed)
    simple_torque = -aero.torque * throttle * throttle
    # Supplement to the book, "propeller thrust and torque": the speed at which motor and propeller
    # torque balance is the positive root of a quadratic. Multiply by reciprocals, as those of
    # constants are computed once for all lanes.
    d = aero.diameter
    d3 = density * d * d * d
    conductance = 1.0 / aero.resistance
    a = aero.cq0 * d3 * d * d * (_REV_PER_RAD * _REV_PER_RAD)
    bb = aero.cq1 * d3 * d * _REV_PER_RAD * airspeed + aero.kq * aero.kq * conductance
    volts = aero.v_max * throttle
    cc = aero.cq2 * d3 * airspeed * airspeed - aero.kq * volts * conductance + aero.kq * aero.i0
    disc = bb * bb - 4.0 * a * cc
    # Without a torque balance (windmilling) the propeller is taken as stopped.
    disc = disc if disc > 0.0 else 0.0
    omega = (np.sqrt(disc) - bb) * (0.5 / a)
    omega = omega if omega > 0.0 else 0.0
    n = omega * _REV_PER_RAD
    nd = n * d
    va = airspeed
    thrust = density * d * d * (aero.ct0 * nd * nd + aero.ct1 * nd * va + aero.ct2 * va * va)
    torque = -d3 * (aero.cq0 * nd * nd + aero.cq1 * nd * va + aero.cq2 * va * va)
    current = (volts - aero.kq * omega) * conductance
    # Select by arithmetic, as a branch would prevent vectorisation.
    use = aero.direct_current
    rest = 1.0 - use
    return use * thrust + rest * simple, use * torque + rest * simple_torque, use * current


@inlined
def forces_moments(
    air: tuple[float, float, float],
    rates: tuple[float, float, float],
    controls: tuple[float, float, float, float],
    density: float,
    aero: Aero,
) -> tuple[float, float, float, float, float, float]:
    """Aerodynamic and propulsive force [N] and moment [N m] in body axes, without gravity.

    Parameters
    ----------
    air : 3 floats
        Velocity of the body relative to the air, body axes [m/s].
    rates : 3 floats
        Body rates p, q, r [rad/s].
    controls : 4 floats
        Elevator, aileron, rudder [rad], throttle (0 to 1).
    density : float
        Of the air [kg/m^3].
    aero : Aero
    """
    ur, vr, wr = air
    p, q, r = rates
    de, da, dr, dt = controls
    plane = ur * ur + wr * wr
    va = np.sqrt(plane + vr * vr)
    in_plane = np.sqrt(plane) + _STILL_AIR_MPS
    alpha, beta = atan2(wr, ur), atan2(vr, in_plane)
    inverse = 1.0 / in_plane
    sa, ca = wr * inverse, ur * inverse
    qd = 0.5 * density * va * va * aero.s
    qr = 0.25 * density * va * aero.s  # dynamic pressure times area over 2 Va, finite at rest

    linear = aero.cl0 + aero.cla * alpha
    ea = exp(aero.stall_m * alpha)
    k = aero.blend  # sigma blends linear lift (0) into that of a flat plate (1)
    sigma = (ea + k + k * ea * ea) / ((ea + k) * (1.0 + k * ea))
    flat = 2.0 * abs(sa) * sa * ca  # 2 sign(alpha) sin(alpha)^2 cos(alpha)
    lift = (
        qd * ((1.0 - sigma) * linear + sigma * flat + aero.clde * de) + qr * aero.clq * aero.c * q
    )
    drag = (
        qd * (aero.cdp + aero.induced * linear * linear + aero.cdde * de)
        + qr * aero.cdq * aero.c * q
    )
    thrust, torque, _ = propulsion_output(va, dt, density, aero)
    pb, rb = aero.b * p, aero.b * r
    return (
        lift * sa - drag * ca + thrust,
        qd * (aero.cy0 + aero.cyb * beta + aero.cyda * da + aero.cydr * dr)
        + qr * (aero.cyp * pb + aero.cyr * rb),
        -drag * sa - lift * ca,
        aero.b * qd * (aero.cr0 + aero.crb * beta + aero.crda * da + aero.crdr * dr)
        + aero.b * qr * (aero.crp * pb + aero.crr * rb)
        + torque,
        aero.c * qd * (aero.cm0 + aero.cma * alpha + aero.cmde * de)
        + aero.c * qr * aero.cmq * aero.c * q,
        aero.b * qd * (aero.cn0 + aero.cnb * beta + aero.cnda * da + aero.cndr * dr)
        + aero.b * qr * (aero.cnp * pb + aero.cnr * rb),
    )


class WingInputs(NamedTuple):
    """What determines the motion besides the state.

    Elevator, aileron, rudder [rad] and throttle (0 to 1); wind and gravity NED [m/s, m/s^2];
    density of the air [kg/m^3]; the airframe.
    """

    controls: tuple[float, float, float, float]
    wind: tuple[float, float, float]
    gravity: tuple[float, float, float]
    density: float
    body: Inertia
    aero: Aero


@inlined
def state_derivative(state: State13, given: WingInputs) -> State13:
    """Time derivative of the 13 states of `rigidbody_kernel`."""
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    wind = given.wind
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    air = (u - wx, v - wy, w - wz)
    fx, fy, fz, mx, my, mz = forces_moments(
        air, (p, q, r), given.controls, given.density, given.aero
    )
    return rigid_body_derivative(state, (fx, fy, fz), (mx, my, mz), given.gravity, given.body)
