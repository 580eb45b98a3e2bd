"""The summary of a run, accumulated result by result: memory grows by its alarms and a few numbers
per epoch.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from analysis.recordings.position_reference import PositionReference
from analysis.results import Decision, FusedState, Result, SensorDecision
from analysis.samples.block import EPHEMERIS, TRUTH, Block
from analysis.samples.sample import Vector
from analysis.scoring.alarm_windows import Alarm, alarms_of, channel_of, windows_of
from analysis.scoring.attitude_scores import REPEATED
from analysis.scoring.criteria import Criteria, check_criteria, overall_verdict
from analysis.scoring.outcome import false_alarms, fault_outcomes
from analysis.scoring.position_scores import UNKNOWN, PositionScores
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.wire.label import Label

PositionResult = Decision | FusedState  # results with a position
FILTER = "filter"  # the detector's own position among the solutions
TOO_MANY = "more satellites contradict each other than the monitor may leave out (left_out)"
SHOWN_REASONS = 3  # most frequent reasons in the summary
EPOCH_US = 1_000_000  # between epochs, where there are too few to measure it


class Tally:
    """Counts epochs, collects alarms and position errors; the truth is in the log or in
    `reference`."""

    def __init__(self, reference: PositionReference | None = None, *, link: bool = True) -> None:
        self.epochs = 0
        self.untestable: Counter[str] = Counter()  # epochs by the reason
        self.first_us: int | None = None
        self.last_us = 0
        self.alarms: list[Alarm] = []
        # Channels that tested something; a link is always monitored by its frame count.
        self._watched = {"link"} if link else set()
        self._epochs_us: tuple[int, int] = (0, 0)  # the first and the last
        self._truth: Vector | None = None  # latitude, longitude in degrees, altitude (3,)
        self._reference = reference
        self.positions = PositionScores()
        self.unexplained: Counter[str] = Counter()  # likewise
        # Of each satellite without a usable ephemeris the first reason, and its epochs.
        self._unused: dict[str, tuple[str, int]] = {}
        self._wrong_ephemerides: list[str] = []
        self._orbit_difference_m: dict[str, float] = {}  # of each satellite the largest
        self.without_imu = 0  # epochs of raw ranges that no IMU predicted
        self.unbounded = 0  # epochs with a position without an error bound

    @property
    def span_s(self) -> float:
        """Time from the first sample to the last, in seconds."""
        return (self.last_us - (self.first_us or 0)) * 1e-6

    @property
    def epoch_us(self) -> int:
        """The mean time between epochs, in microseconds."""
        first_us, last_us = self._epochs_us
        # n epochs have n - 1 gaps.
        return (last_us - first_us) // (self.epochs - 1) if self.epochs > 1 else EPOCH_US

    def add(self, block: Block, results: Sequence[tuple[int, Result]]) -> None:
        """Add a block of samples, and its results with the rows that led to them."""
        # Ephemerides and ionosphere have no stamp of the vehicle's clock.
        stamps = block.t_us[block.kind < EPHEMERIS]
        if len(stamps):
            if self.first_us is None:
                self.first_us = int(stamps[0])
            self.last_us = max(self.last_us, int(stamps.max()))
        # Most rows of a block have a sensor result, mostly without an alarm.
        sensors = [result for _, result in results if isinstance(result, SensorDecision)]
        located = [(row, result) for row, result in results if isinstance(result, PositionResult)]
        reporting: list[Result] = [result for result in sensors if result.alarm]
        reporting += [result for _, result in located]
        self._watched.update({result.sensor for result in sensors if result.statistic is not None})
        self._watched.update(filter(None, map(channel_of, reporting)))
        for result in reporting:
            self.alarms += alarms_of(result)
            if isinstance(result, Decision):
                self._count(result)
        self._add_errors(located, self._true_positions(block, located))

    def _true_positions(
        self, block: Block, located: Sequence[tuple[int, PositionResult]]
    ) -> Vector:
        """The true position at each result, ECEF (n, 3); NaN where it is unknown."""
        if self._reference is not None:
            known = [self._reference.at(result.t_us) for _, result in located]
            return np.array([UNKNOWN if place is None else place for place in known]).reshape(-1, 3)
        truths = block.rows(TRUTH)
        # The newest truth at or before the row that led to each result.
        at = np.searchsorted(truths, [row for row, _ in located], side="right") - 1
        places = block.values[truths[at], 7:10] if len(truths) else np.empty((len(at), 3))
        # Before the block's first truth: that of the previous block, if there was one.
        places[at < 0] = np.nan if self._truth is None else self._truth
        if len(truths):
            # For the results of the next block, until its first truth.
            self._truth = block.values[truths[-1], 7:10].copy()
        lat, lon = np.radians(places[:, :2]).T
        return ecef_from_geodetic(lat, lon, places[:, 2])

    def _count(self, result: Decision) -> None:
        first_us = self._epochs_us[0] if self.epochs else result.t_us
        self._epochs_us = first_us, result.t_us
        self.epochs += 1
        if result.hypothesis == "untestable":
            self.untestable[result.reason] += 1
        if result.hypothesis == "multiple-unknown":
            self.unexplained[result.reason or TOO_MANY] += 1
        self._wrong_ephemerides += result.wrong_ephemerides or ()
        for name, off_m in (result.orbit_difference_m or {}).items():
            self._orbit_difference_m[name] = max(
                self._orbit_difference_m.get(name, 0.0), off_m, key=abs
            )
        for name, reason in result.unused.items():
            first, count = self._unused.get(name, (reason, 0))
            self._unused[name] = first, count + 1
        self.without_imu += result.mode in ("free", "start")
        located = result.position_ecef_m is not None
        self.unbounded += located and result.position_sigma_m is None

    def _add_errors(self, located: Sequence[tuple[int, PositionResult]], true_m: Vector) -> None:
        """Errors by solution, of the results with a position, where `true_m` (n, 3) does."""
        numbers: dict[str, list[int]] = {}
        for number, (_, result) in enumerate(located):
            # One test for all three: they are known together.
            if result.position_ecef_m is not None and not np.isnan(true_m[number, 0]):
                name = FILTER if isinstance(result, Decision) else result.name.replace(" ", "_")
                numbers.setdefault(name, []).append(number)
        for name, mine in numbers.items():
            results = [located[number][1] for number in mine]
            places = [result.position_ecef_m or UNKNOWN for result in results]
            sigmas = [result.position_sigma_m or UNKNOWN for result in results]
            self.positions.add(name, places, sigmas, true_m[mine])

    def _fused_summary(self) -> dict[str, float | None]:
        """The error of the fused position, where it was fused and the truth is known."""
        names = [name for name in self.positions.solutions() if name != FILTER]
        return {f"{name}_position_rmse_m": self.positions.rmse_m(name) for name in names}

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
            The injected faults; None if unknown.
        attitude : mapping
            Scores by estimator; the criteria apply to the first that does not repeat the truth.
        criteria : Criteria
            Limits for the verdict.
        wall_s : float
            How long the run took.
        """
        windows = windows_of(self.alarms, self.epoch_us)
        false = None
        if labels is not None:
            false = false_alarms(labels, windows, self.span_s, self.epoch_us)
        outcomes = fault_outcomes(labels or (), windows, self._watched, self.epoch_us)
        # An autopilot that repeats the truth would make every criterion pass.
        first = next((attitude[name] for name in attitude if not name.endswith(REPEATED)), None)
        content: dict[str, Any] = {
            "verdict": "NO VERDICT",
            "sim_s": round(self.span_s, 3),
            "wall_s": round(wall_s, 2),
            "epochs": self.epochs,
            "false_alarms": None if false is None else sum(r.outside + r.inside for r in false),
            "false_by_channel": None if false is None else msgspec.to_builtins(false),
            "alarms": len(windows),
            "watched": sorted(self._watched),
            "untestable_epochs": self.untestable.total(),
            "untestable_reasons": dict(self.untestable.most_common(SHOWN_REASONS)),
            "attitude_rmse_deg": first["rmse_deg"] if first else None,
            "unexplained_epochs": self.unexplained.total(),
            "unexplained_reasons": dict(self.unexplained),
            "wrong_ephemerides": self._wrong_ephemerides,
            "orbit_difference_m": dict(sorted(self._orbit_difference_m.items())),
            "unused_satellites": [
                {"satellite": name, "reason": reason, "epochs": count}
                for name, (reason, count) in sorted(self._unused.items())
            ],
            "epochs_without_imu": self.without_imu,
            "unbounded_epochs": self.unbounded,
            "position_rmse_m": self.positions.rmse_m(FILTER),
            **self._fused_summary(),
            "position_error": self.positions.summary(),
            "faults": msgspec.to_builtins(outcomes),
            "attitude": dict(attitude),
        }
        checks = check_criteria(criteria, content)
        content["verdict"] = overall_verdict(checks)
        content["criteria"] = [msgspec.structs.asdict(check) for check in checks]
        return content
