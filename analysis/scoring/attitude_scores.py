"""Attitude errors in time bins, and the scores computed from them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.wire.label import Label

AXES = ("roll", "pitch", "yaw", "angle")
PHASES = ("ground", "turn", "climb", "descent", "level")
GROUND_SPEED_MPS = 1.0  # above the noise of a standing vehicle's velocity, below flight
TURN_RAD = np.radians(15.0)  # bank beyond what holding a straight course needs
CLIMB_MPS = 1.0  # above what gusts do in level flight
REPEATED = " (the truth itself)"
REPEATED_DEG = 0.01  # median error below which a source repeats the truth: no estimator is as good


class ErrorBins(NamedTuple):
    """Errors of one estimator in c time bins.

    `t_us` (c,): start times; `phase` (c,): indices into PHASES; `sums` (c, 9): count, sums of
    squares (4) and maxima (4) in rad; `first` (c, 4): first error of each bin in rad.
    """

    t_us: Stamps
    phase: Indices
    sums: Vector
    first: Vector

    def at(self, index: Any) -> "ErrorBins":
        """The bins at an index or mask."""
        return ErrorBins(*(column[index] for column in self))


def score_breakdown(bins: ErrorBins, labels: Sequence[Label], bin_us: int) -> dict[str, Any]:
    """Scores of the entire flight, without faults, by flight phase and by fault.

    RMSE (`max` is the largest of roll, pitch and yaw) and maxima in degrees; percentiles are those
    of the angle between estimate and truth, of the first error in each bin.
    """
    within = [_within(bins, label, bin_us) for label in labels]
    # With a row of zeros, as there may be no fault.
    faulty = np.any([np.zeros(len(bins.t_us), bool), *within], axis=0)
    phases = sorted({PHASES[i] for i in bins.phase.tolist()})
    return score_bins(bins) | {
        "nominal": score_bins(bins.at(~faulty)),
        "phases": {name: score_bins(bins.at(bins.phase == PHASES.index(name))) for name in phases},
        "faults": {
            label.id: score_bins(bins.at(inside))
            for label, inside in zip(labels, within, strict=True)
        },
    }


def score_bins(bins: ErrorBins) -> dict[str, Any]:
    """The scores of some bins; only `samples` = 0 where there are none."""
    if not len(bins.t_us):
        return {"samples": 0}
    sums = bins.sums
    count = sums[:, 0].sum()
    rmse = np.degrees(np.sqrt(sums[:, 1:5].sum(axis=0) / count))
    largest = np.degrees(sums[:, 5:].max(axis=0))
    # From the first error of each bin: all errors of an hour would fill memory.
    angles = np.degrees(bins.first[:, 3])
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
    """The scores by estimator; `sources` that only repeat the truth, as a simulator in place of an
    autopilot does, come last with `REPEATED` after their name."""
    repeated = {
        name
        for name in sources
        if name in scores and scores[name]["angle_percentiles_deg"]["50"] < REPEATED_DEG
    }
    own = {name: scores[name] for name in scores if name not in repeated}
    return own | {name + REPEATED: scores[name] for name in sorted(repeated)}


def flight_phases(q_nb: Vector, v_ned_mps: Vector) -> Indices:
    """Indices into PHASES from speed, bank and climb of truths (n, 4), (n, 3)."""
    w, x, y, z = q_nb.T
    bank = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    down = v_ned_mps[:, 2]
    conditions = [
        np.linalg.norm(v_ned_mps, axis=1) < GROUND_SPEED_MPS,
        np.abs(bank) > TURN_RAD,
        down < -CLIMB_MPS,
        down > CLIMB_MPS,
    ]
    # The first match: on the ground nothing else counts, and a climbing turn is a turn.
    return np.select(conditions, range(4), 4)


def _within(bins: ErrorBins, label: Label, bin_us: int) -> NDArray[np.bool_]:
    """Mask (c,) of the bins that overlap a fault's interval."""
    inside = bins.t_us + bin_us > label.start_us
    return inside if label.end_us is None else inside & (bins.t_us < label.end_us)
