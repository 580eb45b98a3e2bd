"""The sources other than IMU and pseudoranges: each adds factors while it is there and healthy."""

import math
from typing import Any

import gtsam
import numpy as np

from analysis.fdi.position import measure
from analysis.fusion.config import FusionConfig
from analysis.fusion.factors import airspeed_factor, baro_factor, key, mag_factor
from analysis.fusion.graph import Graph
from analysis.gnss import geodetic
from analysis.reference import STALE_S
from analysis.reference_models import SLOW_AIR_MPS, density_kgpm3, pressure_altitude_m
from analysis.results import Decision
from analysis.samples import (
    AirspeedSample,
    BaroSample,
    GpsFix,
    MagSample,
    Sample,
    VisionSample,
)
from simvehicle.rotation import matrix_from_quat

WAITING: dict[type, str] = {
    BaroSample: "baro",
    MagSample: "mag",
    AirspeedSample: "airspeed",
    VisionSample: "vision",
    GpsFix: "gps-position",
}
WIND_SIGMA_MPS = 6.0
OFFSET_SIGMA_M = 5.0  # of the first guess of a barometer's offset


def attach_others(
    graph: Graph,
    decision: Decision,
    waiting: dict[str, Sample],
    vision: Any,
    isolated: set[str],
    config: FusionConfig,
) -> tuple[Any, dict[str, float]]:
    """The newest sample of each source onto the newest epoch.

    Returns the pose by vision at this epoch (None without), and the weights of the sources.
    """
    used: dict[str, float] = {}
    seen: Any = None
    for source, sample in waiting.items():
        if abs(sample.t_us - decision.t_us) * 1e-6 > STALE_S:
            continue
        if source in isolated:
            used[source] = 0.0
            continue
        if isinstance(sample, BaroSample):
            done = _baro(graph, sample, config)
        elif isinstance(sample, MagSample):
            done = _mag(graph, sample, config)
        elif isinstance(sample, AirspeedSample):
            done = _airspeed(graph, sample, config)
        elif isinstance(sample, VisionSample):
            seen = _seen(graph, sample)
            done = _vision(graph, vision, seen, config)
        elif isinstance(sample, GpsFix) and decision.mode.startswith("position"):
            if config.decide and (decision.excluded or decision.hypothesis not in ("none", "imu")):
                used[source] = 0.0
                continue
            done = _fix(graph, sample, config)
        else:
            continue
        if done:
            used[source] = 1.0
    return seen, used


def _baro(graph: Graph, sample: BaroSample, config: FusionConfig) -> bool:
    if not sample.pressure_pa > 0.0:
        return False
    r_m = graph.node.pose.translation()
    _, _, height = geodetic(graph.frame.ecef(r_m))
    # The graph's z is the height above the anchor's tangent plane, not above the ellipsoid.
    altitude = pressure_altitude_m(sample.pressure_pa) - (height - float(r_m[2]))
    walk = config.baro_walk_m * math.sqrt(graph.dt_s)
    graph.slow("h", altitude - float(r_m[2]), OFFSET_SIGMA_M, walk)
    graph.attach("baro", baro_factor(graph.node.epoch, altitude, config))
    return True


def _mag(graph: Graph, sample: MagSample, config: FusionConfig) -> bool:
    if not graph.inertial or not np.isfinite(sample.field_b_gauss).all():
        return False
    factor = mag_factor(graph.node.epoch, sample.field_b_gauss, graph.frame, config)
    graph.attach("mag", factor)
    return True


def _airspeed(graph: Graph, sample: AirspeedSample, config: FusionConfig) -> bool:
    if not math.isfinite(sample.diff_pressure_pa):
        return False
    _, _, height = geodetic(graph.frame.ecef(graph.node.pose.translation()))
    speed = math.sqrt(2.0 * max(sample.diff_pressure_pa, 0.0) / density_kgpm3(height))
    if speed < SLOW_AIR_MPS:
        return False
    walk = config.wind_walk_mps * math.sqrt(graph.dt_s)
    graph.slow("w", np.zeros(3), WIND_SIGMA_MPS, walk)
    graph.attach("airspeed", airspeed_factor(graph.node.epoch, speed, config))
    return True


def _seen(graph: Graph, sample: VisionSample) -> Any:
    """The pose by vision, moved to the epoch's time."""
    if not np.isfinite(sample.r_ned_m).all():
        return None
    late_s = (graph.node.t_us - sample.t_us) * 1e-6
    r_m = sample.r_ned_m
    if sample.v_ned_mps is not None:
        r_m = r_m + sample.v_ned_mps * late_s
    return gtsam.Pose3(gtsam.Rot3(matrix_from_quat(sample.q_nb)), r_m)


def _vision(graph: Graph, before: Any, now: Any, config: FusionConfig) -> bool:
    """Vision as odometry: its own origin and north drop out between two epochs."""
    if before is None or now is None or not graph.inertial:
        return False
    epoch = graph.node.epoch
    sigmas = np.array([config.vision_rad] * 3 + [config.vision_m] * 3)
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    moved = before.between(now)
    graph.attach(
        "vision", gtsam.BetweenFactorPose3(key("x", epoch - 1), key("x", epoch), moved, noise)
    )
    return True


def _fix(graph: Graph, sample: GpsFix, config: FusionConfig) -> bool:
    """A receiver's own solution, where there are no raw ranges."""
    measured, _ = measure(sample)
    if measured is None:
        return False
    epoch, axes = graph.node.epoch, measured.axes
    to_local = graph.frame.axes @ axes.T
    spread = config.correlation**2 * to_local @ np.diag(measured.variance_m2) @ to_local.T
    gaussian = gtsam.noiseModel.Gaussian.Covariance
    r_m = graph.frame.local(measured.r_ecef_m)
    graph.attach("gps-position", gtsam.GPSFactor(key("x", epoch), r_m, gaussian(spread)))
    if measured.v_ned_mps is not None and np.isfinite(measured.v_ned_mps).all():
        noise = gtsam.noiseModel.Isotropic.Sigma(3, config.gps_mps)
        velocity = to_local @ measured.v_ned_mps
        graph.attach("gps-velocity", gtsam.PriorFactorPoint3(key("v", epoch), velocity, noise))
    return True
