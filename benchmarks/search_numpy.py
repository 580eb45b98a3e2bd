"""The same flight in plain numpy over many trajectories: what the compiled kernel is compared with.

Quaternion RK4, sensors with noise and Heun's estimator, written the straightforward way.
"""

import numpy as np

from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.rigidbody_kernel import Inertia

GRAVITY, DENSITY = 9.80665, 1.225


def derivative(x, controls, a: Aero, m: Inertia):
    """Slopes (13, n) and specific force (3, n) of states (13, n)."""
    u, v, w, e0, e1, e2, e3, p, q, r = x[3:]
    de, da, dr, dt = controls
    va = np.sqrt(u * u + v * v + w * w)
    alpha, beta = np.arctan2(w, u), np.arcsin(v / va)
    qd = 0.5 * DENSITY * va**2 * a.s
    pb, qc, rb = a.b * p / (2 * va), a.c * q / (2 * va), a.b * r / (2 * va)
    ea, k = np.exp(a.stall_m * alpha), a.blend
    sigma = (ea + k + k * ea * ea) / ((ea + k) * (1 + k * ea))
    linear = a.cl0 + a.cla * alpha
    sa, ca = np.sin(alpha), np.cos(alpha)
    flat = 2 * np.sign(alpha) * sa**2 * ca
    lift = qd * ((1 - sigma) * linear + sigma * flat + a.clq * qc + a.clde * de)
    drag = qd * (a.cdp + a.induced * linear**2 + a.cdq * qc + a.cdde * de)
    thrust = 0.5 * DENSITY * a.disc * ((a.k_motor * dt) ** 2 - va**2)
    fx = (lift * sa - drag * ca + thrust) / m.mass_kg
    fy = qd * (a.cy0 + a.cyb * beta + a.cyp * pb + a.cyr * rb + a.cyda * da + a.cydr * dr)
    fy = fy / m.mass_kg
    fz = (-drag * sa - lift * ca) / m.mass_kg
    mx = qd * a.b * (a.cr0 + a.crb * beta + a.crp * pb + a.crr * rb + a.crda * da + a.crdr * dr)
    my = qd * a.c * (a.cm0 + a.cma * alpha + a.cmq * qc + a.cmde * de)
    mz = qd * a.b * (a.cn0 + a.cnb * beta + a.cnp * pb + a.cnr * rb + a.cnda * da + a.cndr * dr)
    gx, gy, gz = (
        2 * (e1 * e3 - e0 * e2) * GRAVITY,
        2 * (e2 * e3 + e0 * e1) * GRAVITY,
        (e0**2 - e1**2 - e2**2 + e3**2) * GRAVITY,
    )
    slopes = np.stack(
        [
            (1 - 2 * (e2**2 + e3**2)) * u
            + 2 * (e1 * e2 - e0 * e3) * v
            + 2 * (e1 * e3 + e0 * e2) * w,
            2 * (e1 * e2 + e0 * e3) * u
            + (1 - 2 * (e1**2 + e3**2)) * v
            + 2 * (e2 * e3 - e0 * e1) * w,
            2 * (e1 * e3 - e0 * e2) * u
            + 2 * (e2 * e3 + e0 * e1) * v
            + (1 - 2 * (e1**2 + e2**2)) * w,
            r * v - q * w + gx + fx,
            p * w - r * u + gy + fy,
            q * u - p * v + gz + fz,
            0.5 * (-p * e1 - q * e2 - r * e3),
            0.5 * (p * e0 + r * e2 - q * e3),
            0.5 * (q * e0 - r * e1 + p * e3),
            0.5 * (r * e0 + q * e1 - p * e2),
            m.g1 * p * q - m.g2 * q * r + m.g3 * mx + m.g4 * mz,
            m.g5 * p * r - m.g6 * (p * p - r * r) + m.inverse_jy * my,
            m.g7 * p * q - m.g1 * q * r + m.g4 * mx + m.g8 * mz,
        ]
    )
    return slopes, np.stack([fx, fy, fz])


def inverse(x, y):
    """Right-hand side (9, n) of the inverse sensor models."""
    (sf, st, sy), (cf, ct, cy) = np.sin(x[:3]), np.cos(x[:3])
    u, v, w = x[3:6]
    p, q, r = y[:3]
    turn = q * sf + r * cf
    return np.stack(
        [
            p + turn * st / ct,
            q * cf - r * sf,
            turn / ct,
            y[3] + r * v - q * w - GRAVITY * st,
            y[4] + p * w - r * u + GRAVITY * ct * sf,
            y[5] + q * u - p * v + GRAVITY * ct * cf,
            ct * cy * u + (sf * st * cy - cf * sy) * v + (cf * st * cy + sf * sy) * w,
            ct * sy * u + (sf * st * sy + cf * cy) * v + (cf * st * sy - sf * cy) * w,
            -st * u + sf * ct * v + cf * ct * w,
        ]
    )


def euler(e0, e1, e2, e3):
    """Angles (3, n)."""
    return np.stack(
        [
            np.arctan2(2 * (e0 * e1 + e2 * e3), 1 - 2 * (e1**2 + e2**2)),
            np.arcsin(np.clip(2 * (e0 * e2 - e3 * e1), -1, 1)),
            np.arctan2(2 * (e0 * e3 + e1 * e2), 1 - 2 * (e2**2 + e3**2)),
        ]
    )


def fly(x, controls, aero, body, steps, dt, rng):
    """RMSE (3, n) in rad of the estimator over `steps` steps from states (13, n)."""
    sigma = np.repeat([np.radians(0.13), 0.0245], 3)[:, None]
    estimate = np.concatenate([euler(*x[6:10]), x[3:6], x[:3]])
    squares, before = np.zeros((3, x.shape[1])), None
    for _ in range(steps):
        k1, force = derivative(x, controls, aero, body)
        y = np.concatenate([x[10:13], force]) + sigma * rng.standard_normal((6, x.shape[1]))
        if before is not None:
            s1 = inverse(estimate, before)
            s2 = inverse(estimate + dt * s1, y)
            estimate = estimate + 0.5 * dt * (s1 + s2)
        before = y
        error = estimate[:3] - euler(*x[6:10])
        squares += ((error + np.pi) % (2 * np.pi) - np.pi) ** 2
        k2 = derivative(x + 0.5 * dt * k1, controls, aero, body)[0]
        k3 = derivative(x + 0.5 * dt * k2, controls, aero, body)[0]
        k4 = derivative(x + dt * k3, controls, aero, body)[0]
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x[6:10] /= np.sqrt((x[6:10] ** 2).sum(axis=0))
    return np.sqrt(squares / steps)
