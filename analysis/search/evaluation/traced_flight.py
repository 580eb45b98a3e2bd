"""One traced flight: truth, sensor samples and estimate; and any estimator on those samples."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.estimators import Estimator, Prior
from analysis.samples.sample import AirspeedSample, GpsFix, ImuSample, MagSample, Sample
from analysis.search.lanes import rows
from analysis.search.lanes.filter_lanes import MAHONY
from analysis.search.lanes.noise_kernel import streams
from analysis.search.lanes.search_kernel import Plan, fly
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlightTrace:
    """n samples of a flight.

    state (n, 13) as in `rigidbody_kernel`; measured (n, CHANNELS) as in `rows`, slow sensors
    repeated; estimate (n, 9): roll, pitch, yaw, and for the inverse sensor model velocity and
    position; `q_estimate` (n, 4); `alive` (n,).
    """

    plan: Plan
    state: Array
    measured: Array
    estimate: Array
    q_estimate: Array
    alive: NDArray[np.bool_]

    @property
    def t_s(self) -> Array:
        """Times (n,)."""
        return np.arange(len(self.state), dtype=np.float64) * self.plan.dt_s

    def errors_rad(self) -> Array:
        """Roll, pitch, yaw, wrapped, and angle between estimate and truth (n, 4)."""
        pairs = zip(self.q_estimate, self.state[:, 6:10], strict=True)
        return np.array([attitude_errors(q, truth) for q, truth in pairs])


def trace_flight(plan: Plan, flight: Array, filters: Array, seed: int, number: int) -> FlightTrace:
    """Fly one column (ROWS,) with noise `number` of `seed`; `filters` (FILTER_SIZE,) is the
    filter's initial state."""
    # For any criterion: the kernel computes the quaternion only for that of the angle.
    plan = plan._replace(angle=True)
    # The kernel flies one flight per lane: the same in each.
    lanes = np.ascontiguousarray(np.repeat(flight[:, None], rows.LANES, axis=1))
    noise = np.repeat(streams(seed, np.array([number])), rows.LANES, axis=1)
    out = np.empty((plan.steps + 1, 13 + rows.CHANNELS + 14))
    fly(lanes, np.repeat(filters[None, :], rows.LANES, axis=0), noise, plan, out)
    state, measured, estimate, q, alive = np.split(
        out, np.cumsum([13, rows.CHANNELS, 9, 4]), axis=1
    )
    return FlightTrace(plan, state, measured, estimate, q, alive[:, 0] > 0.5)


def sensor_samples(flight: FlightTrace) -> Iterator[list[Sample]]:
    """The samples of each step: IMU, field, airspeed, GPS, as they are due."""
    plan = flight.plan
    for k, measured in enumerate(flight.measured):
        t_us = round(k * plan.dt_s * 1e6)
        samples: list[Sample] = [ImuSample(t_us, measured[0:3], measured[3:6])]
        # In the order of the kernel: another order changes the last bits of a filter.
        if k > 0 and k % plan.field_every == 0:
            samples.append(MagSample(t_us, measured[6:9]))
        if k > 0 and k % plan.pressure_every == 0 and not plan.rotors:
            samples.append(AirspeedSample(t_us, float(measured[12])))
        if k > 0 and k % plan.velocity_every == 0 and not np.isnan(measured[9]):
            # These estimators use the velocity only, not the position.
            samples.append(GpsFix(t_us, 0.0, 0.0, 0.0, measured[9:12], 3, 10, 1.0, 1.0, "HIL_GPS"))
        yield samples


def estimate_attitude(flight: FlightTrace, estimator: Estimator) -> Array:
    """The attitude (n, 4) of an estimator on a flight's samples, started at the truth."""
    first = flight.state[0]
    prior = Prior(
        0,
        first[6:10],
        matrix_from_quat(first[6:10]) @ first[3:6],
        first[0:3],
        flight.plan.declination_rad,
    )
    state = estimator.start(prior)
    out = np.empty((len(flight.state), 4))
    for k, samples in enumerate(sensor_samples(flight)):
        for sample in samples:
            estimate, state = estimator.update(sample, state)
        out[k] = estimate.q_nb
    return out


def with_all_sensors(plan: Plan) -> Plan:
    """The plan with all slow sensors sampled, for estimators in Python."""
    # The inverse model uses only the IMU, so its plan leaves the slow sensors out.
    return plan if plan.estimator > 0 else plan._replace(estimator=MAHONY)
