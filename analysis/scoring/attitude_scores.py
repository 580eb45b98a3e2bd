"""Errors gathered in cells, and the scores that are made of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import Indices, Stamps
from analysis.samples.sample import Vector

AXES = ("roll", "pitch", "yaw", "angle")
PHASES = ("ground", "turn", "climb", "descent", "level")
GROUND_SPEED_MPS = 1.0
TURN_RAD = np.radians(15.0)
CLIMB_MPS = 1.0
REPEATED = " (the truth itself)"
REPEATED_DEG = 0.01  # half of what is said is closer: no estimator is as good


class FaultInterval(Protocol):
    """When a fault acted; a label of the proxy's is one."""

    @property
    def id(self) -> str:
        """Its name."""

    @property
    def start_us(self) -> int:
        """When it began."""

    @property
    def end_us(self) -> int | None:
        """When it ended; None if it did not."""


class ErrorBins(NamedTuple):
    """Errors of one estimator within c cells.

    `t_us` (c,): their beginnings; `phase` (c,): places in PHASES; `sums` (c, 9): how many errors,
    sums of squares (4) and maxima (4) in rad; `first` (c, 4): the first error of each in rad.
    """

    t_us: Stamps
    phase: Indices
    sums: Vector
    first: Vector

    def at(self, index: Any) -> "ErrorBins":
        """Some of them."""
        return ErrorBins(*(column[index] for column in self))


def score_breakdown(
    cells: ErrorBins, windows: Sequence[FaultInterval], cell_us: int
) -> dict[str, Any]:
    """Scores of the whole, without faults, by phase of flight and by fault.

    RMSE (`max` is the largest of roll, pitch and yaw) and maxima in degrees; percentiles are
    those of the turn between estimate and truth, of the first error in each cell.
    """
    within = [_within(cells, window, cell_us) for window in windows]
    # With a row of zeros, as there may be no window at all.
    faulty = np.any([np.zeros(len(cells.t_us), bool), *within], axis=0)
    flown = sorted({PHASES[i] for i in cells.phase.tolist()})
    return score_bins(cells) | {
        "nominal": score_bins(cells.at(~faulty)),
        "phases": {name: score_bins(cells.at(cells.phase == PHASES.index(name))) for name in flown},
        "faults": {
            window.id: score_bins(cells.at(inside))
            for window, inside in zip(windows, within, strict=True)
        },
    }


def score_bins(cells: ErrorBins) -> dict[str, Any]:
    """The scores of some cells; only `samples` = 0 where there are none."""
    if not len(cells.t_us):
        return {"samples": 0}
    sums = cells.sums
    count = sums[:, 0].sum()
    rmse = np.degrees(np.sqrt(sums[:, 1:5].sum(axis=0) / count))
    largest = np.degrees(sums[:, 5:].max(axis=0))
    # Of the first error of each cell: all errors of an hour would fill memory.
    angles = np.degrees(cells.first[:, 3])
    rmse_deg = dict(zip(AXES, rmse.tolist(), strict=True))
    return {
        "samples": int(count),
        "rmse_deg": rmse_deg | {"max": float(rmse[:3].max())},
        "max_deg": dict(zip(AXES, largest.tolist(), strict=True)),
        "angle_percentiles_deg": {
            str(p): float(value)
            for p, value in zip((50, 95, 99), np.percentile(angles, (50, 95, 99)), strict=True)
        },
    }


def put_repeaters_last(scores: Mapping[str, Any], sources: Sequence[str]) -> dict[str, Any]:
    """The scores by estimator; those of `sources` that only repeat the truth, as a simulator in the
    place of the autopilot does, come last under a name that says so."""
    repeated = {
        name
        for name in sources
        if name in scores and scores[name]["angle_percentiles_deg"]["50"] < REPEATED_DEG
    }
    own = {name: scores[name] for name in scores if name not in repeated}
    return own | {name + REPEATED: scores[name] for name in sorted(repeated)}


def flight_phases(q_nb: Vector, v_ned_mps: Vector) -> Indices:
    """Places in PHASES by speed, bank and climb of truths (n, 4), (n, 3)."""
    w, x, y, z = q_nb.T
    bank = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    down = v_ned_mps[:, 2]
    conditions = [
        np.linalg.norm(v_ned_mps, axis=1) < GROUND_SPEED_MPS,
        np.abs(bank) > TURN_RAD,
        down < -CLIMB_MPS,
        down > CLIMB_MPS,
    ]
    # The first that holds: on the ground nothing else counts, and a climbing turn is a turn.
    return np.select(conditions, range(4), 4)


def _within(cells: ErrorBins, window: FaultInterval, cell_us: int) -> NDArray[np.bool_]:
    """Which cells (c,) a window touches."""
    inside = cells.t_us + cell_us > window.start_us
    return inside if window.end_us is None else inside & (cells.t_us < window.end_us)
