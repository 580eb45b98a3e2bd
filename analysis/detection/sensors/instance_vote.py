"""Detects the faulty one of several sensors of a kind by a majority vote.

The differences of their means over a window are constant: mounting, calibration. Two differences
that change together isolate the sensor that both have in common (docs/watches.md, "Several sensors
of a kind").
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.detection.receiver.imu_scatter import QUIETEST
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import (
    BARO,
    FIX,
    FIX_3D,
    FIX_TYPE,
    IMU,
    IMU_ID,
    MAG,
    SPARE,
    SPARE_ID,
    SPARE_KIND,
    SPARE_NUMBERS,
    Block,
    Indices,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import (
    MEAN_EARTH_RADIUS_M,
    SEA_LEVEL_DENSITY_KGPM3,
    STANDARD_GRAVITY_MPS2,
)
from mavproxy_fault.numerics.rotations.rotation import wrap_angles

MOST_INSTANCES = 3  # of one kind
LEARNED_WINDOWS, MEMORY_WINDOWS = 10, 60  # before the first test, of the usual difference
CHANGE_SIGMAS = 8.0  # half or twice changes no row of benchmarks/instance_votes.py; p 1e-15
CONFIRM_WINDOWS = 3  # in a row: one or two are a manoeuvre; each takes 0.5 to 2 s
STANDARD_ERRORS = 4.0  # of the difference of two means: vibration is not the same everywhere
NOISE_GAIN = np.log(16.0)  # of a variance: with half of it ArduCopter's healthy IMUs are noisy
PAIRS = tuple(combinations(range(MOST_INSTANCES), 2))
METRES_PER_PASCAL = 1.0 / (SEA_LEVEL_DENSITY_KGPM3 * STANDARD_GRAVITY_MPS2)  # 0.0832, hydrostatic


class VoterKind(NamedTuple):
    """The sensors of one kind: `sensor` is their channel; a mean is over `window_us` with at least
    `fewest` samples; `limits` (n,) are the smallest changes of a difference that count."""

    kind: int
    sensor: str
    name: str
    window_us: int
    fewest: int
    limits: Vector


VOTERS = (
    # rad/s and m/s^2; gauss; m; m north, east, up
    VoterKind(IMU, "imu", "IMU", 500_000, 5, np.repeat([0.03, 0.5], 3)),
    VoterKind(MAG, "mag", "magnetometer", 1_000_000, 3, np.full(3, 0.1)),
    VoterKind(BARO, "baro", "barometer", 1_000_000, 3, np.array([3.0])),
    VoterKind(FIX, "gps-position", "receiver", 2_000_000, 3, np.array([10.0, 10.0, 15.0])),
)


@dataclass
class UsualValue:
    """Mean and mean square (n,) of the difference of two sensors, or of the logarithm of a sensor's
    variance; windows, and outliers in a row."""

    mean: Vector
    square: Vector
    windows: int = 0
    outliers: int = 0

    def has_left(self, change: Vector, beyond: bool) -> bool:
        """Whether the changes (n,) of several windows were `beyond` their limits. Learning stops
        meanwhile, or the fault would become usual."""
        if self.windows >= LEARNED_WINDOWS and beyond:
            self.outliers += 1
            return self.outliers >= CONFIRM_WINDOWS
        self.outliers = 0
        self.windows += 1
        # A plain mean at first, then one over MEMORY_WINDOWS.
        share = 1.0 / min(self.windows, MEMORY_WINDOWS)
        self.mean = self.mean + share * change
        self.square = self.square + share * (change**2 * (1.0 - share) - self.square)
        return False


def new_usual(count: int) -> UsualValue:
    """Nothing is known of `count` values."""
    return UsualValue(np.zeros(count), np.zeros(count))


class VoteState:
    """The window of one kind that is being filled: sums and those of squared changes from sample to
    sample (MOST_INSTANCES, n), counts (MOST_INSTANCES,), newest samples; and the differences."""

    def __init__(self, count: int) -> None:
        self.window: int | None = None
        self.sums = np.zeros((MOST_INSTANCES, count))
        self.changes = np.zeros((MOST_INSTANCES, count))
        self.counts = np.zeros(MOST_INSTANCES)
        self.newest = np.full((MOST_INSTANCES, count), np.nan)
        self.meridian_rad = np.nan  # longitudes are compared near that of the first fix
        self.missing = np.zeros(MOST_INSTANCES, int)  # windows in a row without a sample
        self.noise = [new_usual(count) for _ in range(MOST_INSTANCES)]
        self.differences = {pair: new_usual(count) for pair in PAIRS}


class InstanceVoteDetector(BlockDetector, frozen=True):
    """Compares sensors of a kind; idle with a single sensor of each kind."""

    channels: ClassVar = frozenset(voters.sensor for voters in VOTERS)

    def new_state(self) -> list[VoteState]:
        """No sample has come yet."""
        return [VoteState(len(voters.limits)) for voters in VOTERS]

    def step(self, block: Block, state: list[VoteState]) -> tuple[RowResults, list[VoteState]]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        results: RowResults = []
        spare = block.rows(SPARE)
        for voters, own in zip(VOTERS, state, strict=True):
            results += _vote(block, spare, voters, own)
        return results, state


def _vote(block: Block, spare: Indices, voters: VoterKind, state: VoteState) -> RowResults:
    rows, ids = _rows(block, spare, voters.kind)
    # Only the first sensor has samples so far.
    if state.window is None and not ids.any():
        return []
    numbers = _compared_values(block, rows, voters.kind, state)
    known = (ids >= 0) & (ids < MOST_INSTANCES) & np.isfinite(numbers).all(axis=1)
    rows, ids, numbers = rows[known], ids[known], numbers[known]
    windows = block.t_us[rows] // voters.window_us
    results: RowResults = []
    for begin, end in _runs(windows):
        row, window = int(rows[begin]), int(windows[begin])
        if window != state.window:
            results += [
                (row, result) for result in _vote_window(int(block.t_us[row]), voters, state)
            ]
            state.window = window
            state.sums[:], state.changes[:], state.counts[:] = 0.0, 0.0, 0.0
        for i in np.unique(ids[begin:end]):
            _add(state, int(i), numbers[begin:end][ids[begin:end] == i])
    return results


def _add(state: VoteState, i: int, samples: Vector) -> None:
    """Add samples (m, n) of a sensor to the window."""
    changes = np.diff(samples, axis=0, prepend=state.newest[i : i + 1])
    state.sums[i] += samples.sum(axis=0)
    state.changes[i] += np.nansum(changes**2, axis=0)  # the first sample has none
    state.counts[i] += len(samples)
    state.newest[i] = samples[-1]


def _rows(block: Block, spare: Indices, kind: int) -> tuple[Indices, Indices]:
    """The rows (m,) of all sensors of a kind in order, and the number of each one's sensor."""
    rows = block.rows(kind)
    ids = block.values[rows, IMU_ID].astype(int) if kind == IMU else np.zeros(len(rows), int)
    further = spare[block.values[spare, SPARE_KIND] == kind]
    if not len(further):
        return rows, ids
    ids = np.r_[ids, block.values[further, SPARE_ID].astype(int)]
    rows = np.r_[rows, further]
    order = np.argsort(rows, kind="stable")
    return rows[order], ids[order]


def _compared_values(block: Block, rows: Indices, kind: int, state: VoteState) -> Vector:
    """The values that sensors of a kind are compared by (m, n); not finite if there is none."""
    first = block.kind[rows] == kind
    count = IMU_ID if kind == IMU else 3
    at = np.where(first, 0, SPARE_NUMBERS)[:, None] + np.arange(count)
    values: Vector = block.values[rows[:, None], at]
    if kind in (IMU, MAG):
        return values
    if kind == BARO:
        return -METRES_PER_PASCAL * values[:, :1]
    lat, lon = np.radians(values[:, 0]), np.radians(values[:, 1])
    if not np.isfinite(state.meridian_rad) and np.isfinite(lon).any():
        state.meridian_rad = float(lon[np.isfinite(lon)][0])
    lon = state.meridian_rad + wrap_angles(lon - state.meridian_rad)
    level = MEAN_EARTH_RADIUS_M * np.column_stack([lat, lon * np.cos(lat)])
    results = np.column_stack([level, values[:, 2]])
    results[first & ~(block.values[rows, FIX_TYPE] >= FIX_3D)] = np.nan
    return results


def _runs(numbers: Indices) -> Iterator[tuple[int, int]]:
    """Begin and end of runs of equal numbers."""
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    return ((a, b) for a, b in pairwise(edges) if b > a)


def _vote_window(t_us: int, voters: VoterKind, state: VoteState) -> list[SensorDecision]:
    """The vote on a full window."""
    if voters.kind in (MAG, BARO) and (silent := _silent(state)):
        names = " and ".join(f"{voters.name} {i + 1}" for i in silent)
        for_s = voters.window_us * 1e-6 * min(state.missing[i] for i in silent)
        return [pattern_alarm(t_us, voters.sensor, f"silent for {for_s:.0f} s: {names}")]
    sampled = [i for i in range(MOST_INSTANCES) if state.counts[i] >= voters.fewest]
    mean = {i: state.sums[i] / state.counts[i] for i in sampled}
    # Variance of the mean: a change between samples has twice that of one, without slow motion.
    error = {i: state.changes[i] / (2.0 * state.counts[i] ** 2) for i in sampled}
    outliers = {
        (i, j)
        for i, j in combinations(sampled, 2)
        if _is_off(
            mean[i] - mean[j],
            state.differences[i, j],
            np.maximum(voters.limits, STANDARD_ERRORS * np.sqrt(error[i] + error[j])),
        )
    }
    noisy = _noisy({i: error[i] * state.counts[i] for i in sampled}, state)
    if len(noisy) == 1:
        return [_result(t_us, voters, noisy, "is noisy, unlike the others")]
    outvoted = [
        i
        for i in sampled
        if len(sampled) > 2 and sum(i in pair for pair in outliers) == len(sampled) - 1
    ]
    if len(outvoted) == 1:
        return [_result(t_us, voters, outvoted, "disagrees with the others")]
    if len(sampled) == 2 and outliers:
        return [_result(t_us, voters, sampled, "disagree")]
    return []


def _noisy(variances: dict[int, Vector], state: VoteState) -> list[int]:
    """The sensors that have gained noise while no other has, by their variances (n,)."""
    gains = {i: np.log(variances[i] + QUIETEST) - state.noise[i].mean for i in variances}
    found = []
    for i, gain in gains.items():
        others = [gains[j] for j in gains if j != i and state.noise[j].windows >= LEARNED_WINDOWS]
        excess = gain - np.max([np.zeros(len(gain)), *others], axis=0)
        if state.noise[i].has_left(gain, bool(others) and bool((excess > NOISE_GAIN).any())):
            found.append(i)
    return found


def _silent(state: VoteState) -> list[int]:
    """Additional sensors that are silent while others are not. The first one of a kind and every
    IMU are streams; only a receiver's fixes are compared."""
    state.missing = np.where(state.counts > 0, 0, state.missing + 1)
    return [
        i
        for i in range(1, MOST_INSTANCES)
        if state.missing[i] >= CONFIRM_WINDOWS
        and state.differences[0, i].windows >= LEARNED_WINDOWS
    ]


def _is_off(difference: Vector, known: UsualValue, limits: Vector) -> bool:
    """Whether a difference (n,) has left its usual value, which is learned as long as it stays."""
    change = difference - known.mean
    limit = np.maximum(limits, CHANGE_SIGMAS * np.sqrt(known.square))
    return known.has_left(change, bool((np.abs(change) > limit).any()))


def _result(t_us: int, voters: VoterKind, instances: list[int], text: str) -> SensorDecision:
    names = [f"{voters.name} {i + 1}" for i in instances]
    return pattern_alarm(
        t_us,
        voters.sensor,
        f"{' and '.join(names)} {text}",
        isolated=len(instances) == 1,
        dof=len(voters.limits),
    )
