"""Factors of an epoch's pseudoranges and Doppler rates.

Galileo's inter-system bias is taken from the detector's filter, which has estimated it for longer
than the graph's window.
"""

import math
from typing import Any

import gtsam
import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.inertial import R
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.isolation.epoch_memory import frozen_offsets_m
from analysis.fusion.factors.factor_weights import residual_weight
from analysis.fusion.factors.range_rows import (
    ABOVE_MASK,
    CORRECTED,
    NORMALISED,
    RATE,
    RATE_SIGMA,
    SIGMA,
    NodeState,
    range_table,
    snapshot_covariance,
    whiten_rows,
)
from analysis.fusion.factors.unary_factors import unit_noise
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph_start import ClockState, Node
from analysis.fusion.learned_noise import LearnedNoise
from analysis.fusion.local_frame import LocalFrame
from analysis.fusion.window import variable_key
from analysis.orbits.broadcast import CLOCK as SAT_CLOCK
from analysis.orbits.snapshot import systems_of
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

NO_LEVER_ARM = np.zeros(3)
MIN_WEIGHT = 0.02  # smaller weights change nothing: the measurement is left out


class EpochRanges:
    """The measurements of one epoch, corrected by the models at the filter's state x (21,).

    Weights (n,) are in the order of the satellites, 0 where one is left out. The offsets that the
    detector has frozen are subtracted here too, so that both use the same ranges.
    """

    def __init__(
        self,
        observation: EpochObservation,
        x: Vector,
        core: DetectorCore,
        config: FusionConfig,
        detector: DetectorConfig,
        t_us: int,
    ) -> None:
        self.satellites = observation.satellites
        self._observation, self._config, self._doppler = observation, config, detector.doppler
        self._r_m = x[R : R + 3]
        names, frozen = observation.satellites, core.memory.frozen
        offset_m = frozen_offsets_m(frozen, names, t_us, detector)
        measurements = observation.measurements._replace(
            pseudorange_m=observation.measurements.pseudorange_m - offset_m
        )
        self.table = range_table(
            observation._replace(measurements=measurements),
            x,
            core.broadcast.ionosphere,
            detector.sigma,
            config.correlation,
            math.radians(detector.mask_deg),
        )

    @property
    def sigma_m(self) -> Vector:
        """Sigmas (n,) of the pseudoranges in the graph."""
        result: Vector = self.table[:, SIGMA]
        return result

    @property
    def normalised(self) -> Vector:
        """Innovations (n, 2) of ranges and rates over the detector's sigmas."""
        result: Vector = self.table[:, NORMALISED : NORMALISED + 2]
        return result

    @property
    def has_rates(self) -> bool:
        """Whether the measurements include rates."""
        return self._doppler and bool(np.isfinite(self.table[:, RATE]).any())

    def weights(self, by_name: dict[str, float]) -> Vector:
        """Weights (n,) from weights by name; 0 below the mask or `MIN_WEIGHT`."""
        weights = [by_name.get(name, 0.0) for name in self.satellites]
        above = self.table[:, ABOVE_MASK].tolist()
        # 0 where the satellite is below the mask.
        return np.array(
            [a if a >= MIN_WEIGHT and b else 0.0 for a, b in zip(weights, above, strict=True)]
        )

    def residual_weights(self, excluded: frozenset[str]) -> Vector:
        """Weights from the residuals at the filter's state, for epochs the detector did not
        test."""
        config = self._config
        if not config.decide:
            return self.weights(dict.fromkeys(self.satellites, 1.0))
        normalised = zip(self.satellites, self.table[:, NORMALISED].tolist(), strict=True)
        return self.weights(
            {
                name: 0.0
                if name in excluded
                else residual_weight(value, config.suspicious, config.hopeless)
                for name, value in normalised
            }
        )

    def scale_rates(self, noise: LearnedNoise) -> None:
        """Scale the rates' sigmas by the learned factors."""
        noise.scale_rates(self.satellites, self.table[:, RATE_SIGMA])

    def factor(
        self,
        node: Node,
        origin: Any,
        frame: LocalFrame,
        clock: ClockState,
        weights: Vector,
        rates_only: bool,
    ) -> Any | None:
        """One factor on pose, velocity and clock of all pseudoranges and rates of an epoch,
        weighted by `weights` (n,); None if there are none.

        The ranges are `PseudorangeFactorArm`s without a lever arm, linearised at the filter's
        position: the error is d^2/2R at a distance d, 2 micrometres at 10 m. The graph's clock is
        relative to `clock`; `origin` holds the initial values of the epoch, pose and velocity those
        of the node.
        """
        pose = node.pose.matrix()
        rows = whiten_rows(
            self.table,
            weights,
            frame.axes,
            pose[:3, 3] - frame.local(self._r_m),
            NodeState(pose, node.velocity, *clock),
            not rates_only,
            self._doppler,
        )
        if not len(rows):
            return None
        x, v, c = (variable_key(letter, node.epoch) for letter in "xvc")
        row = gtsam.JacobianFactor(
            x, rows[:, :6], v, rows[:, 6:9], c, rows[:, 9:11], rows[:, 11], unit_noise(len(rows))
        )
        return gtsam.LinearContainerFactor(row, origin)

    def pseudorange(
        self, i: int, pose: int, seconds: int, frame: LocalFrame, clock: ClockState, noise: Any
    ) -> Any:
        """One satellite's factor on a pose and a clock in seconds, two keys."""
        state = self._observation.satellite_states[i]
        return gtsam.PseudorangeFactorArm(
            pose,
            seconds,
            # The graph's clock is relative to this, which keeps its variable small.
            self.table[i, CORRECTED] - clock[0],
            state[:3],
            NO_LEVER_ARM,
            frame.pose,
            state[SAT_CLOCK] / SPEED_OF_LIGHT_MPS,
            noise,
        )

    @property
    def unknowns(self) -> int:
        """Number of unknowns of a snapshot solution."""
        return 3 + len(systems_of(self._observation.measurements.system))

    def slow_covariance(self, weights: Vector, share: float) -> Vector | None:
        """Covariance (3, 3) in ECEF of the errors that do not average out; None if undetermined.

        Multipath, ephemeris and atmosphere last for minutes: a bias of `share` sigmas per
        satellite, propagated to the position by the snapshot solution.
        """
        # The table's sigmas include the correlation factor; this needs those of one epoch.
        sigmas = share / self._config.correlation
        covariance = snapshot_covariance(
            self.table, weights, self._observation.measurements.system, sigmas
        )
        return covariance if math.isfinite(covariance[0, 0]) else None
