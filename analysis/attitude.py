"""Scores of attitude estimators against the truth that travels beside the sensor frames.

Estimates wait for the truth samples on both sides of them and are compared with the truth between
those; one that comes up to a second late, as from an autopilot on a link, still counts. Errors are
gathered in cells of `1 / rate_hz`: sums at the full rate of the estimates for the scores, the first
error of each cell as a result.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.epochs import AttitudeSample, ImuSample, Sample, TruthSample
from analysis.estimators import Estimator, Prior, make
from analysis.estimators.rotations import between, errors
from analysis.results import AttitudeError
from mavproxy_fault.wire.compiled import compiled

Vector = NDArray[np.float64]
AXES = ("roll", "pitch", "yaw", "angle")
MAX_TRUTH_GAP_S = 1.0  # truth is not interpolated over a longer pause
LATEST_US = 1_000_000  # how long the truth is kept for estimates that come late
GROUND_SPEED_MPS = 1.0
TURN_RAD = np.radians(15.0)
CLIMB_MPS = 1.0


class AttitudeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which estimators run; `imu` is the IMU they see, `settle_s` the time left out at the start.

    `declination_deg` None takes it from the World Magnetic Model at the first true position.
    """

    estimators: tuple[str, ...] = ("ekf",)
    rate_hz: float = 10.0
    imu: int = 0
    settle_s: float = 0.0
    declination_deg: float | None = None


class Window(Protocol):
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


class Cell(NamedTuple):
    """Errors of one estimator within one cell.

    `sums` (9,): how many, sums of squares (4,) and maxima (4,) in rad; `first` (4,) in rad.
    """

    t_us: int
    phase: str
    sums: Vector
    first: Vector


@compiled
def add_error(sums: Vector, error: Vector) -> Vector:
    """The sums of a cell with one more error (4,)."""
    out = sums.copy()
    out[0] += 1.0
    for i in range(4):
        out[1 + i] += error[i] * error[i]
        out[5 + i] = max(out[5 + i], abs(error[i]))
    return out


class ScorerState:
    """What moves while scoring.

    Changed in place, against the habit of the rest: it holds a history that grows by every cell,
    and copying that for each IMU sample would cost more than the estimators.
    """

    def __init__(self) -> None:
        self.t0_us: int | None = None
        self.estimators: dict[str, Any] = {}
        self.truths: deque[TruthSample] = deque()
        self.waiting: list[tuple[int, str, Vector]] = []
        self.cells: dict[str, list[Cell]] = {}


class AttitudeScorer:
    """A step of the pipeline; nothing is scored before the first truth sample."""

    def __init__(self, config: AttitudeConfig) -> None:
        self.config = config
        self._estimators: dict[str, Estimator] = {name: make(name) for name in config.estimators}
        self._cell_us = round(1e6 / config.rate_hz)

    def new_state(self) -> ScorerState:
        """The state before the first sample."""
        return ScorerState()

    def step(self, sample: Sample, state: ScorerState) -> tuple[list[AttitudeError], ScorerState]:
        """Errors that the sample completes, thinned to `rate_hz` for each estimator."""
        if isinstance(sample, TruthSample):
            results = self._score(sample, state)
            self._take_truth(sample, state)
            return results, state
        if state.t0_us is None:
            return [], state
        if isinstance(sample, AttitudeSample):
            state.waiting.append((sample.t_us, sample.source, sample.q_nb))
            return [], state
        if isinstance(sample, ImuSample) and sample.id != self.config.imu:
            return [], state
        for name, estimator in self._estimators.items():
            estimate, state.estimators[name] = estimator.update(sample, state.estimators[name])
            if isinstance(sample, ImuSample):
                state.waiting.append((estimate.t_us, name, estimate.q_nb))
        return [], state

    def _take_truth(self, sample: TruthSample, state: ScorerState) -> None:
        if state.t0_us is None:
            state.t0_us = sample.t_us
            prior = Prior(
                sample.t_us,
                sample.q_nb,
                sample.v_ned_mps,
                declination_rad=self._declination_rad(sample),
            )
            state.estimators = {name: e.start(prior) for name, e in self._estimators.items()}
        state.truths.append(sample)
        while state.truths[0].t_us < sample.t_us - LATEST_US and len(state.truths) > 2:
            state.truths.popleft()

    def _declination_rad(self, sample: TruthSample) -> float:
        if self.config.declination_deg is not None:
            return float(np.radians(self.config.declination_deg))
        return declination_rad(sample.lat_deg, sample.lon_deg, sample.alt_m)

    def _score(self, after: TruthSample, state: ScorerState) -> list[AttitudeError]:
        """Compare what waited with the truth up to this sample."""
        results: list[AttitudeError] = []
        if not state.truths or state.t0_us is None or after.t_us <= state.truths[-1].t_us:
            return results
        later = []
        for t_us, name, q_nb in state.waiting:
            if t_us > after.t_us:
                later.append((t_us, name, q_nb))
                continue
            pair = _around(t_us, state.truths, after)
            if pair is not None:
                first, second = pair
                share = (t_us - first.t_us) / (second.t_us - first.t_us)
                error = errors(q_nb, between(first.q_nb, second.q_nb, share))
                if self._gather(state, name, t_us, error, second):
                    results.append(_result(name, t_us, state.t0_us, error))
        state.waiting = later
        return results

    def _gather(
        self, state: ScorerState, name: str, t_us: int, error: Vector, truth: TruthSample
    ) -> bool:
        """Add one error to its cell; whether it opened a new one."""
        assert state.t0_us is not None
        if t_us - state.t0_us < self.config.settle_s * 1e6:
            return False
        cells = state.cells.setdefault(name, [])
        start_us = t_us - (t_us - state.t0_us) % self._cell_us
        last = cells[-1] if cells else None
        if last is not None and last.t_us == start_us:
            cells[-1] = Cell(start_us, last.phase, add_error(last.sums, error), last.first)
            return False
        cells.append(Cell(start_us, flight_phase(truth), add_error(np.zeros(9), error), error))
        return True

    def summary(self, state: ScorerState, labels: Sequence[Window] = ()) -> dict[str, Any]:
        """Scores by estimator, as `parted` gives them."""
        return {
            name: parted(cells, labels, self._cell_us)
            for name, cells in sorted(state.cells.items())
        }


def _around(
    t_us: int, truths: deque[TruthSample], after: TruthSample
) -> tuple[TruthSample, TruthSample] | None:
    """The truth just before and just after an instant, if it is known close enough."""
    first, second = truths[-1], after
    if t_us < first.t_us:
        k = bisect_left(truths, t_us, key=lambda truth: truth.t_us)
        if k == 0 and t_us < truths[0].t_us:
            return None
        first, second = truths[max(k - 1, 0)], truths[max(k, 1)]
    return (first, second) if second.t_us - first.t_us <= MAX_TRUTH_GAP_S * 1e6 else None


def parted(cells: Sequence[Cell], windows: Sequence[Window], cell_us: int) -> dict[str, Any]:
    """Scores of the whole, without faults, by phase of flight and by fault.

    RMSE (`max` is the largest of roll, pitch and yaw) and maxima in degrees; percentiles are
    those of the turn between estimate and truth, of the first error in each cell.
    """
    faulty = [any(_within(cell, window, cell_us) for window in windows) for cell in cells]
    return scored(cells) | {
        "nominal": scored([c for c, bad in zip(cells, faulty, strict=True) if not bad]),
        "phases": {
            phase: scored([c for c in cells if c.phase == phase])
            for phase in sorted({c.phase for c in cells})
        },
        "faults": {
            window.id: scored([c for c in cells if _within(c, window, cell_us)])
            for window in windows
        },
    }


def scored(cells: Sequence[Cell]) -> dict[str, Any]:
    """The scores of some cells; only `samples` = 0 where there are none."""
    if not cells:
        return {"samples": 0}
    sums = np.array([cell.sums for cell in cells])
    count = sums[:, 0].sum()
    rmse = np.degrees(np.sqrt(sums[:, 1:5].sum(axis=0) / count))
    largest = np.degrees(sums[:, 5:].max(axis=0))
    angles = np.degrees([cell.first[3] for cell in cells])
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


def flight_phase(truth: TruthSample) -> str:
    """The phase of flight of a truth sample."""
    return phase_of(truth.q_nb, truth.v_ned_mps)


def phase_of(q_nb: Vector, v_ned_mps: Vector) -> str:
    """ground, turn, climb, descent or level, by speed, bank and climb rate of the truth."""
    w, x, y, z = q_nb
    bank = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    north, east, down = v_ned_mps
    if np.sqrt(north * north + east * east + down * down) < GROUND_SPEED_MPS:
        return "ground"
    if abs(bank) > TURN_RAD:
        return "turn"
    if abs(down) > CLIMB_MPS:
        return "climb" if down < 0.0 else "descent"
    return "level"


def declination_rad(lat_deg: float, lon_deg: float, alt_m: float) -> float:
    """Magnetic declination by the World Magnetic Model 2025 at its epoch."""
    from pygeomag import GeoMag

    field = GeoMag(coefficients_file="wmm/WMM_2025.COF").calculate(
        glat=lat_deg, glon=lon_deg, alt=alt_m / 1000.0, time=2025.0
    )
    return float(np.radians(field.d))


def _within(cell: Cell, window: Window, cell_us: int) -> bool:
    return cell.t_us + cell_us > window.start_us and (
        window.end_us is None or cell.t_us < window.end_us
    )


def _result(name: str, t_us: int, t0_us: int, error: Vector) -> AttitudeError:
    roll, pitch, yaw, angle = np.degrees(error).tolist()
    return AttitudeError(
        t_s=(t_us - t0_us) * 1e-6,
        t_us=t_us,
        estimator=name,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        angle=angle,
    )
