"""The summary of a run, gathered result by result, so that an hour of flight needs no more memory
than its alarms.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from analysis.results import AttitudeError, Decision, FusedState, Result
from analysis.samples.block import EPHEMERIS, TRUTH, Block
from analysis.samples.sample import Vector
from analysis.scoring.alarm_windows import Alarm, alarms_of, channel_of, windows_of
from analysis.scoring.attitude_scores import REPEATED
from analysis.scoring.criteria import Criteria, judge, verdict
from analysis.scoring.outcome import false_alarms, outcomes
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.wire.label import Label

PLACED = (Decision, FusedState)  # results that tell a position
EPOCH_US = 1_000_000  # between epochs, where too few came to tell


class Tally:
    """Counts epochs, collects alarms and adds up the position error."""

    def __init__(self) -> None:
        self.epochs = 0
        self.untestable = 0
        self.first_us: int | None = None
        self.last_us = 0
        self.alarms: list[Alarm] = []
        self._watched = {"link"}  # channels that tested something
        self._epochs_us: tuple[int, int] = (0, 0)  # the first and the last
        self._truth: Vector | None = None  # latitude, longitude in degrees, altitude (3,)
        self._errors = 0
        self._square_m2 = 0.0
        self._fused: dict[str, tuple[int, float]] = {}  # how many, sum of squared errors in m^2

    @property
    def span_s(self) -> float:
        """Time from the first sample to the last, in seconds."""
        return (self.last_us - (self.first_us or 0)) * 1e-6

    @property
    def epoch_us(self) -> int:
        """The mean time between epochs, in microseconds."""
        first_us, last_us = self._epochs_us
        return (last_us - first_us) // (self.epochs - 1) if self.epochs > 1 else EPOCH_US

    def add(self, block: Block, found: Sequence[tuple[int, Result]]) -> None:
        """Count a block of samples, and its results with the rows that led to them."""
        stamps = block.t_us[block.kind < EPHEMERIS]
        if len(stamps):
            if self.first_us is None:
                self.first_us = int(stamps[0])
            self.last_us = max(self.last_us, int(stamps.max()))
        verdicts = [pair for pair in found if not isinstance(pair[1], AttitudeError)]
        for _, result in verdicts:
            self.alarms += alarms_of(result)
            channel = channel_of(result)
            if channel is not None:
                self._watched.add(channel)
        placed = [pair for pair in verdicts if isinstance(pair[1], PLACED)]
        for (_, result), true_m in zip(placed, self._true_positions(block, placed), strict=True):
            self._add(result, true_m)

    def _true_positions(self, block: Block, found: Sequence[tuple[int, Result]]) -> list[Any]:
        """Where the vehicle really was at each result, ECEF (3,); None where that is not known."""
        truths = block.rows(TRUTH)
        if self._truth is None and not len(truths):
            return [None] * len(found)
        # The newest truth at or before the row that led to each result.
        at = np.searchsorted(truths, [row for row, _ in found], side="right") - 1
        places = block.values[truths[at], 7:10] if len(truths) else np.empty((len(at), 3))
        places[at < 0] = np.nan if self._truth is None else self._truth
        if len(truths):
            # For the results of the next block, until its first truth.
            self._truth = block.values[truths[-1], 7:10].copy()
        lat, lon = np.radians(places[:, :2]).T
        true_m = ecef_from_geodetic(lat, lon, places[:, 2])
        return [None if np.isnan(x) else [x, y, z] for x, y, z in true_m.tolist()]

    def _add(self, result: Result, true_m: Sequence[float] | None) -> None:
        if isinstance(result, FusedState) and true_m is not None:
            count, total_m2 = self._fused.get(result.name, (0, 0.0))
            error_m2 = math.dist(true_m, result.position_ecef_m) ** 2
            self._fused[result.name] = count + 1, total_m2 + error_m2
        if not isinstance(result, Decision):
            return
        first_us = self._epochs_us[0] if self.epochs else result.t_us
        self._epochs_us = first_us, result.t_us
        self.epochs += 1
        self.untestable += result.hypothesis == "untestable"
        if result.position_ecef_m is not None and true_m is not None:
            self._square_m2 += math.dist(true_m, result.position_ecef_m) ** 2
            self._errors += 1

    def _fused_summary(self) -> dict[str, float]:
        """The error of the fused position, where it was fused and the truth is known."""
        return {
            f"{name.replace(' ', '_')}_position_rmse_m": round(math.sqrt(total_m2 / count), 3)
            for name, (count, total_m2) in self._fused.items()
        }

    def summary(
        self,
        labels: Sequence[Label] | None,
        attitude: Mapping[str, Any],
        criteria: Criteria,
        wall_s: float,
    ) -> dict[str, Any]:
        """The content of `summary.json`.

        Parameters
        ----------
        labels : sequence of Label
            What was really done; None if nobody knows.
        attitude : mapping
            Scores by estimator; the first that does not repeat the truth is what the criteria
            judge.
        criteria : Criteria
            Limits for the verdict.
        wall_s : float
            How long the run took.
        """
        windows = windows_of(self.alarms)
        false = None if labels is None else false_alarms(labels, windows, self.span_s)
        found_faults = outcomes(labels or (), windows, self._watched, self.epoch_us)
        # An autopilot that repeats the truth would make every criterion pass.
        first = next((attitude[name] for name in attitude if not name.endswith(REPEATED)), None)
        found: dict[str, Any] = {
            "verdict": "NO VERDICT",
            "sim_s": round(self.span_s, 3),
            "wall_s": round(wall_s, 2),
            "epochs": self.epochs,
            "false_alarms": None if false is None else sum(r.outside + r.inside for r in false),
            "false_by_channel": None if false is None else msgspec.to_builtins(false),
            "alarms": len(windows),
            "untestable_epochs": self.untestable,
            "attitude_rmse_deg": first["rmse_deg"] if first else None,
            "position_rmse_m": round(math.sqrt(self._square_m2 / self._errors), 3)
            if self._errors
            else None,
            **self._fused_summary(),
            "faults": msgspec.to_builtins(found_faults),
            "attitude": dict(attitude),
        }
        checks = judge(criteria, found)
        found["verdict"] = verdict(checks)
        found["criteria"] = [msgspec.structs.asdict(check) for check in checks]
        return found
