"""An epoch in which no test trips: one call of compiled code, from the IMU's samples to the filter
and its memory after it.

It does what `motion`, `sight`, `update` and `slow` do one after the other, for the satellites that
were used at the last epoch, and gives up where there is anything to decide: the epoch is then
judged from its beginning by `epoch`. Nearly every epoch of a flight passes.
"""

import numpy as np

from analysis.detection.detection_config import MOST, DetectorConfig
from analysis.detection.detector_state import Core
from analysis.detection.epoch_outcome import Outcome, imu_bad_until_us, shown
from analysis.detection.filter.epoch_update import followed
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.inertial import propagate_freely, propagate_inertial
from analysis.detection.filter.information import (
    block,
    columns,
    narrowed,
    quadratic,
    states_of,
    weighed,
)
from analysis.detection.filter.measurement import Indices, Observed, modelled_at
from analysis.detection.filter.propagation import steps
from analysis.detection.isolation.assessment import (
    CLOCK_LEAP_M,
    normalise,
    parity_test,
    rates_statistic,
    weighed_rates,
)
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.ramp_test import Strongest, judge_slow
from analysis.detection.isolation.range_test import free_position
from analysis.detection.isolation.rate_test import MIN_RATES
from analysis.orbits.broadcast import satellite_states
from analysis.samples.block import ImuRun, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

NOTHING_FOUND = 0.0, -1, -1, 0.0

Filtered = tuple[Vector, Vector, Vector, Vector, Vector, Vector]


def let_pass(
    t_us: int,
    observed: Observed,
    held_m: Vector,
    run: ImuRun,
    core: Core,
    config: DetectorConfig,
) -> Outcome | None:
    """The epoch if nothing of it needs a verdict, None otherwise."""
    motion, memory = core.motion, core.memory
    if motion is None or memory is None or memory.among is not observed.satellites:
        return None
    if core.excluded or len(memory.names) > MOST:
        return None
    if motion.alignment is not None or (motion.inertial and config.antenna is not None):
        return None
    memory = memory.turned_over(t_us)
    passed, table, after, found, numbers, counts = _pass(
        *observed.measured,
        memory.places,
        held_m,
        motion.x,
        motion.p,
        run.t_us,
        run.values,
        motion.inertial,
        config.gap_s,
        t_us,
        motion.t_us,
        core.ionosphere,
        config.sigma.numbers,
        config.noise.densities,
        config.thresholds,
        config.memory_numbers,
        config.mask_rad,
        config.doppler,
        memory.starts_us,
        memory.d,
        memory.sums,
        memory.offset,
        memory.spread,
        memory.offsets,
        memory.spreads,
    )
    if not passed:
        return None
    x, p, d, sums, offset, spread = after
    q, q_rate, parity = numbers
    dof, rates = counts
    residual_m, normalised = table.tolist()
    memory = memory._replace(d=d, sums=sums, offset=offset, spread=spread)
    slow = judge_slow(memory, Strongest(*found), config)
    blamed = motion.inertial and slow.hypothesis == "imu"
    motion = Motion(t_us, x, p, motion.inertial)
    core = core._replace(
        motion=free_position(motion) if blamed else motion,
        ranges_us=t_us,
        memory=memory,
        imu_bad_until_us=imu_bad_until_us(core, blamed, t_us, config),
        unknown_since_us=None,
    )
    tested = config.doppler and rates >= MIN_RATES
    return Outcome(
        core,
        names=memory.names,
        residual_m=residual_m,
        normalised=normalised,
        statistic=q,
        threshold=chi_square(len(residual_m), config.p_false_alarm),
        parity=parity,
        parity_dof=dof,
        rate=q_rate if tested else None,
        rate_threshold=chi_square(rates, config.p_other) if tested else None,
        rate_dof=rates if tested else 0,
        slow=slow,
        hypothesis=shown(core, "none", blamed, False),
        alarm=blamed,
        imu_blamed=blamed,
        was_inertial=motion.inertial,
    )


@compiled
def _pass(
    packed: Vector,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    cn0_dbhz: Vector,
    system: Indices,
    week: float,
    tow_s: float,
    places: Indices,
    held_m: Vector,
    x: Vector,
    p: Vector,
    run_us: Stamps,
    run: Vector,
    inertial: bool,
    most_gap_s: float,
    t_us: int,
    before_us: int,
    ionosphere: Vector,
    sigma: Vector,
    noise: Vector,
    thresholds: Vector,
    memory_numbers: Vector,
    mask_rad: float,
    doppler: bool,
    starts_us: Indices,
    d: Vector,
    sums: Vector,
    offset: Vector,
    spread: Vector,
    offsets: Vector,
    spreads: Vector,
) -> tuple[
    bool,
    Vector,
    Filtered,
    tuple[float, int, int, float],
    tuple[float, float, float],
    tuple[int, int],
]:
    """Whether the epoch passed; innovations and normalised ones (2, n); the filter and its memory
    after it; what the windows say; statistics and counts."""
    dt_s, nothing = (t_us - before_us) * 1e-6, (x, p, d, sums, offset, spread)
    samples, gap_s, heard = steps(run_us, run, before_us, t_us)
    moved = samples.shape[0] > 0 and gap_s <= most_gap_s if inertial else not heard
    if not moved:  # by the IMU without a gap, or there is none
        return False, np.empty((2, 0)), nothing, NOTHING_FOUND, (0.0, 0.0, 0.0), (0, 0)
    if inertial:
        x, p, phi = propagate_inertial(x, p, samples, noise)
    else:
        x, p, phi = propagate_freely(x, p, dt_s, noise)
    states = satellite_states(packed, week, tow_s, pseudorange_m)
    every, geometry = modelled_at(
        states, pseudorange_m, doppler_mps, cn0_dbhz, system, x, tow_s, ionosphere, sigma
    )
    rows, h, as_before = _used(every, geometry, held_m, places, mask_rad)
    v, variance, table = rows[0], rows[2], np.empty((2, places.shape[0]))
    for i in range(v.shape[0]):
        table[0, i] = v[i]
    seen = states_of(h)
    a = columns(h, seen)
    information, b, total = weighed(a, variance, v)
    after, told = narrowed(block(p, seen), information)
    normalise(a, after, b, variance, v, table[1])
    q = total - quadratic(b, after)
    parity, dof, systems = parity_test(a, information, b, total)
    of_rates, b_rates, total_rates, rates = weighed_rates(h, rows[3], rows[1])
    q_rate = rates_statistic(p, of_rates, b_rates, total_rates)
    tested = doppler and rates >= MIN_RATES
    if not tested:
        of_rates, b_rates = np.zeros((4, 4)), np.zeros(4)
    enough = v.shape[0] >= (3 if inertial else 4 + systems)
    statistics, counts = (q, q_rate, parity), (dof, rates)
    rates_fit = not tested or q_rate <= thresholds[1, rates]
    if not (as_before and enough and rates_fit and q <= thresholds[0, v.shape[0]]):
        return False, table, nothing, NOTHING_FOUND, statistics, counts
    x, p, d, sums, offset, spread, found = followed(
        x,
        p,
        seen,
        a,
        information,
        variance,
        v,
        told,
        b,
        of_rates,
        b_rates,
        phi,
        dt_s,
        t_us,
        starts_us,
        d,
        sums,
        offset,
        spread,
        offsets,
        spreads,
        inertial,
        memory_numbers,
    )
    return True, table, (x, p, d, sums, offset, spread), found, statistics, counts


@compiled
def _used(
    every: Vector, geometry: Vector, held_m: Vector, places: Indices, mask_rad: float
) -> tuple[Vector, Vector, bool]:
    """The rows (4, n) and geometry (n, 20) of the satellites at `places`; whether they, and no
    others, are above the mask, and the receiver has not set its clock."""
    rows, h = np.empty((4, places.shape[0])), np.empty((places.shape[0], geometry.shape[1]))
    above, own, far = 0, 0, 0
    for i in range(every.shape[1]):
        above += every[4, i] >= mask_rad
    for i in range(places.shape[0]):
        at = places[i]
        own += every[4, at] >= mask_rad
        for k in range(4):
            rows[k, i] = every[k, at]
        rows[0, i] -= held_m[at]
        far += abs(rows[0, i]) > CLOCK_LEAP_M
        for k in range(h.shape[1]):
            h[i, k] = geometry[at, k]
    return rows, h, above == own == places.shape[0] and 2 * far < own
