"""Factors of the sources other than IMU and pseudoranges, added while they are present and
healthy."""

import math
from typing import Any

import gtsam
import numpy as np

from analysis.detection.receiver.position_test import fix_measurement
from analysis.detection.sensors.sensor_models import (
    SLOW_AIR_MPS,
    density_kgpm3,
    pressure_altitude_m,
)
from analysis.detection.sensors.sensor_tests import STALE_S
from analysis.fusion.factors.factor_weights import residual_weight
from analysis.fusion.factors.range_factors import MIN_WEIGHT
from analysis.fusion.factors.unary_factors import (
    OFFSET_UNIT_M,
    airspeed_factor,
    baro_factor,
    isotropic_noise,
    mag_factor,
    walk_factor,
)
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph import Graph
from analysis.fusion.window import variable_key
from analysis.results import Decision
from analysis.samples.sample import (
    AirspeedSample,
    BaroSample,
    GpsFix,
    MagSample,
    Sample,
    Vector,
    VisionSample,
)
from mavproxy_fault.numerics.earth_kernel import geodetic_position
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat

SOURCE_NAMES: dict[type, str] = {
    BaroSample: "baro",
    MagSample: "mag",
    AirspeedSample: "airspeed",
    VisionSample: "vision",
    GpsFix: "gps-position",
}
WIND_SIGMA_MPS = 6.0  # of the first guess of each wind component: 2 sigma is a strong breeze
OFFSET_SIGMA_M = 5.0  # of the first guess of a barometer's offset: about that of a GNSS height


class SensorFactors:
    """Attaches samples to the nearest epoch of a graph, with the slow states they need.

    Barometer offset and wind have one variable per span of the window, a random walk from the span
    before; after a gap longer than the window they restart.
    """

    def __init__(self, graph: Graph, config: FusionConfig) -> None:
        self._graph, self._config = graph, config
        self._vision_sigmas = np.array([config.vision_rad] * 3 + [config.vision_m] * 3)

    def attach(self, sample: Sample, decision: Decision | None, share: float = 1.0) -> float | None:
        """Attach one sample to its epoch; the weight it got, None if it was not used.

        `share` is the requested weight. A receiver's own position is used only in epochs that were
        decided from it.
        """
        # Too small to change the solution.
        if share < MIN_WEIGHT:
            return 0.0
        # Rows are multiplied by the root: information is proportional to the weight.
        root = math.sqrt(share)
        epoch = self._graph.nearest(sample.t_us, round(STALE_S * 1e6))
        if epoch is None:
            return None
        if isinstance(sample, VisionSample):
            return self._vision(sample, epoch, share)
        # One factor per source and epoch: the first of faster samples.
        if self._graph.window.contains(SOURCE_NAMES.get(type(sample), ""), epoch):
            return None
        used = False
        match sample:
            case BaroSample():
                used = self._baro(sample, epoch, root)
            case MagSample():
                used = self._mag(sample, epoch, root)
            case AirspeedSample():
                used = self._airspeed(sample, epoch, root)
            case GpsFix() if decision and decision.mode.startswith("position"):
                healthy = not decision.excluded and decision.hypothesis in ("none", "imu")
                if self._config.decide and not healthy:
                    return 0.0
                used = self._fix(sample, epoch, share)
        return share if used else None

    def _slow_state(self, letter: str, epoch: int, first: Vector, sigma: float, walk: float) -> int:
        """The key of a slow state at an epoch; `walk` is per square root of a second."""
        graph, window = self._graph, self._graph.window
        span = graph.span(epoch)
        name, stamp_s = variable_key(letter, span), window.span_stamp(span)
        spans = [
            known for known in graph.spans[letter] if window.span_stamp(known) >= window.oldest_s
        ]
        if span not in spans:
            before = max((known for known in spans if known < span), default=None)
            if before is None:
                factor = gtsam.PriorFactorVector(name, first, isotropic_noise(len(first), sigma))
                since_s = stamp_s
            else:
                old, since_s = variable_key(letter, before), window.span_stamp(before)
                walk_sigma = walk * math.sqrt((span - before) * window.span_s)
                factor = walk_factor(old, name, walk_sigma, len(first))
                # Only committed variables have an estimate to start from.
                if window.slots(letter, before):
                    first = np.asarray(window.smoother.calculateEstimateVector(old))
            values = gtsam.Values()
            values.insert(name, first)
            window.insert(values, (name,), stamp_s)
            window.attach(letter, span, since_s, factor)
            spans.append(span)
        graph.spans[letter] = spans
        return name

    def _up_m(self, epoch: int) -> tuple[float, float]:
        """Height above the frame's tangent plane and above the ellipsoid near the epoch."""
        r_m = self._graph.node.pose.translation()
        _, _, height = geodetic_position(self._graph.frame.ecef(r_m))
        return float(r_m[2]), height

    def _baro(self, sample: BaroSample, epoch: int, root: float) -> bool:
        if not sample.pressure_pa > 0.0:
            return False
        up_m, height = self._up_m(epoch)
        # The graph's z is the height above the anchor's tangent plane, not above the ellipsoid.
        altitude = pressure_altitude_m(sample.pressure_pa) - (height - up_m)
        graph, config, unit_m = self._graph, self._config, OFFSET_UNIT_M
        first = np.array([altitude - up_m]) / unit_m
        sigma, walk = OFFSET_SIGMA_M / unit_m, config.baro_walk_m / unit_m
        offset = self._slow_state("h", epoch, first, sigma, walk)
        pose = graph.pose(epoch)
        graph.attach(
            "baro", epoch, baro_factor(epoch, pose, offset, altitude, config.baro_m / root)
        )
        return True

    def _mag(self, sample: MagSample, epoch: int, root: float) -> bool:
        graph = self._graph
        if not graph.aligned or not np.isfinite(sample.field_b_gauss).all():
            return False
        factor = mag_factor(epoch, sample.field_b_gauss, graph.frame, self._config.mag_gauss / root)
        graph.attach("mag", epoch, factor)
        return True

    def _airspeed(self, sample: AirspeedSample, epoch: int, root: float) -> bool:
        if not math.isfinite(sample.diff_pressure_pa):
            return False
        _, height = self._up_m(epoch)
        speed = math.sqrt(2.0 * max(sample.diff_pressure_pa, 0.0) / density_kgpm3(height))
        if speed < SLOW_AIR_MPS:
            return False
        wind = self._slow_state("w", epoch, np.zeros(3), WIND_SIGMA_MPS, self._config.wind_walk_mps)
        self._graph.attach(
            "airspeed", epoch, airspeed_factor(epoch, wind, speed, self._config.airspeed_mps / root)
        )
        return True

    def _vision(self, sample: VisionSample, epoch: int, share: float) -> float | None:
        """Vision as odometry: its origin and north cancel between two epochs."""
        graph = self._graph
        at = graph.epochs[epoch]
        seen = _vision_pose(sample, at.t_us)
        if seen is None or at.vision_pose is not None or not graph.aligned:
            return None
        at.vision_pose = seen
        weight = None
        before, after = graph.vision_neighbours(epoch, round(STALE_S * 1e6))
        for i, j in ((before, epoch), (epoch, after)):
            if i is None or j is None:
                continue
            moved = graph.epochs[i].vision_pose.between(graph.epochs[j].vision_pose)
            weight = min(share, self._plausible_weight(i, j, moved))
            if weight >= MIN_WEIGHT:
                noise = gtsam.noiseModel.Diagonal.Sigmas(self._vision_sigmas / math.sqrt(weight))
                factor = gtsam.BetweenFactorPose3(
                    variable_key("x", i), variable_key("x", j), moved, noise
                )
                graph.attach("vision", j, factor, since=i)
        return weight

    def _plausible_weight(self, i: int, j: int, moved: Any) -> float:
        """Weight of a vision motion, compared with the IMU's: a jump gets none even where the test
        of vision's position, which allows for a drift, does not detect it."""
        graph, config = self._graph, self._config
        edge = graph.epochs[j].edge
        if not config.decide or edge is None or not graph.uses_imu(edge):  # nothing to compare with
            return 1.0
        off = gtsam.Pose3.Logmap(graph.pose(i).between(graph.pose(j)).between(moved))
        return residual_weight(
            float(np.abs(off / self._vision_sigmas).max()), config.suspicious, config.hopeless
        )

    def _fix(self, sample: GpsFix, epoch: int, share: float) -> bool:
        """The receiver's own solution, where there are no raw ranges."""
        graph, config = self._graph, self._config
        measured, _ = fix_measurement(sample)
        if measured is None:
            return False
        to_local = graph.frame.axes @ measured.axes.T
        spread = config.correlation**2 * to_local @ np.diag(measured.variance_m2) @ to_local.T
        gaussian = gtsam.noiseModel.Gaussian.Covariance
        r_m = graph.frame.local(measured.r_ecef_m)
        position = gtsam.GPSFactor(variable_key("x", epoch), r_m, gaussian(spread / share))
        graph.attach("gps-position", epoch, position)
        if measured.v_ned_mps is not None and np.isfinite(measured.v_ned_mps).all():
            noise = isotropic_noise(3, config.gps_mps)
            velocity = to_local @ measured.v_ned_mps
            factor = gtsam.PriorFactorPoint3(variable_key("v", epoch), velocity, noise)
            graph.attach("gps-velocity", epoch, factor)
        return True


def _vision_pose(sample: VisionSample, t_us: int) -> Any:
    """The vision pose, moved to an epoch's time by its velocity."""
    if not np.isfinite(sample.r_ned_m).all():
        return None
    r_m = sample.r_ned_m
    if sample.v_ned_mps is not None:
        r_m = r_m + sample.v_ned_mps * (t_us - sample.t_us) * 1e-6
    return gtsam.Pose3(gtsam.Rot3(matrix_from_quat(sample.q_nb)), r_m)
