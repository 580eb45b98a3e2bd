"""IMUs of one vehicle vote: who disagrees with two others that agree is at fault.

All of them feel the same motion, so that the differences of their means over half a second stay
what they are: mounting, calibration. Two differences that change together name the IMU that both
have in common; of two IMUs a difference tells that one of them is wrong, and not who.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np

from analysis.results import SensorDecision
from analysis.samples.block import IMU, IMU_ID, Block
from analysis.samples.sample import Vector

IMUS, NUMBERS = 3, 6
WINDOW_US = 500_000
LEAST_SAMPLES = 5  # in a window: of fewer the mean hangs on their times
LEARNT, MEMORY = 10, 60  # windows
# rad/s and m/s^2: the least change of a difference that counts, and its own spread
LEAST = np.repeat([0.03, 0.5], 3)
SIGMAS, LASTS = 8.0, 2  # windows in a row
PAIRS = tuple(combinations(range(IMUS), 2))


@dataclass
class Difference:
    """Of two IMUs: mean and mean square (6,) of the difference, windows, windows off in a row."""

    mean: Vector = field(default_factory=lambda: np.zeros(NUMBERS))
    square: Vector = field(default_factory=lambda: np.zeros(NUMBERS))
    windows: int = 0
    off: int = 0


@dataclass
class VoteState:
    """The window that is being filled, its sums (IMUS, 6) and counts (IMUS,), and differences."""

    window: int | None = None
    sums: Vector = field(default_factory=lambda: np.zeros((IMUS, NUMBERS)))
    counts: Vector = field(default_factory=lambda: np.zeros(IMUS))
    differences: dict[tuple[int, int], Difference] = field(
        default_factory=lambda: {pair: Difference() for pair in PAIRS}
    )


@dataclass(frozen=True)
class InstanceVote:
    """A step of the pipeline; with one IMU it does nothing."""

    def new_state(self) -> VoteState:
        """Nothing came yet."""
        return VoteState()

    def step(
        self, block: Block, state: VoteState
    ) -> tuple[list[tuple[int, SensorDecision]], VoteState]:
        """Who disagrees, by the row that shows it, and the next state.

        The state is changed in place.
        """
        rows = block.rows(IMU)
        ids = block.values[rows, IMU_ID].astype(int)
        # Only the first IMU has spoken so far: there is nobody to compare it with.
        if state.window is None and not ids.any():
            return [], state
        known = (ids >= 0) & (ids < IMUS) & np.isfinite(block.values[rows, :NUMBERS]).all(axis=1)
        rows, ids = rows[known], ids[known]
        windows = block.t_us[rows] // WINDOW_US
        found: list[tuple[int, SensorDecision]] = []
        for begin, end in _runs(windows):
            row, window = int(rows[begin]), int(windows[begin])
            if window != state.window:
                found += [(row, result) for result in _judged(int(block.t_us[row]), state)]
                state.window = window
                state.sums[:], state.counts[:] = 0.0, 0.0
            np.add.at(state.sums, ids[begin:end], block.values[rows[begin:end], :NUMBERS])
            np.add.at(state.counts, ids[begin:end], 1.0)
        return found, state


def _runs(numbers: Vector) -> Iterator[tuple[int, int]]:
    """Where equal numbers in a row begin and end."""
    edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    return ((a, b) for a, b in pairwise(edges) if b > a)


def _judged(t_us: int, state: VoteState) -> list[SensorDecision]:
    """The vote on the window that is full."""
    heard = [i for i in range(IMUS) if state.counts[i] >= LEAST_SAMPLES]
    off = {
        pair
        for pair in combinations(heard, 2)
        if _is_off(
            state.sums[pair[0]] / state.counts[pair[0]]
            - state.sums[pair[1]] / state.counts[pair[1]],
            state.differences[pair],
        )
    }
    alone = [
        i for i in heard if len(heard) > 2 and all(_pair(i, j) in off for j in heard if j != i)
    ]
    if len(alone) == 1:
        return [_result(t_us, alone, "disagrees with the others")]
    if len(heard) == 2 and off:
        return [_result(t_us, heard, "disagree")]
    return []


def _pair(i: int, j: int) -> tuple[int, int]:
    return (min(i, j), max(i, j))


def _is_off(now: Vector, known: Difference) -> bool:
    """Whether a difference (6,) has left what it was, which is learnt where it has not."""
    change = now - known.mean
    least = np.maximum(LEAST, SIGMAS * np.sqrt(known.square))
    # Nothing is learnt meanwhile, or the fault would become what is usual.
    if known.windows >= LEARNT and (np.abs(change) > least).any():
        known.off += 1
        return known.off >= LASTS
    known.off = 0
    known.windows += 1
    # A plain mean at first, then one that remembers some 30 s.
    share = 1.0 / min(known.windows, MEMORY)
    known.mean = known.mean + share * change
    known.square = known.square + share * (change**2 * (1.0 - share) - known.square)
    return False


def _result(t_us: int, who: list[int], says: str) -> SensorDecision:
    names = [f"IMU {i + 1}" for i in who]
    return SensorDecision(
        t_s=t_us * 1e-6,
        t_us=t_us,
        sensor="imu",
        statistic=None,
        threshold=None,
        dof=NUMBERS,
        alarm=True,
        isolated=len(who) == 1,
        reason=f"{' and '.join(names)} {says}",
    )
