"""Measurements as factors; keys are letters with the number of an epoch.

x pose (body to local), v velocity, b IMU biases, c receiver clock and d its drift, h the
barometer's offset, w the wind. Clocks are in seconds as GTSAM wants them. Galileo's offset from
the receiver's clock is taken from the detector's filter, which has known it for longer than the
graph remembers; as a state it doubled the time per epoch.
"""

from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import X_ISB
from analysis.fdi.measure import Observed
from analysis.fusion.config import FusionConfig
from analysis.fusion.frame import Frame
from analysis.gnss import LIGHT_MPS, geodetic, klobuchar_m, predict_ranges, troposphere_m
from analysis.samples import Vector
from analysis.solve import design_matrix

NO_ARM = np.zeros(3)
LIGHT = np.array([[LIGHT_MPS]])
LEAST_WEIGHT = 0.02  # less is left out
HUBER = 1.345  # 95 % efficiency for normal noise (Huber 1964)
GEMAN = 3.0


def key(letter: str, epoch: int) -> int:
    """The key of a variable."""
    return int(gtsam.symbol(letter, epoch))


def sigma1(sigma: float) -> Any:
    """The noise of a scalar."""
    return gtsam.noiseModel.Isotropic.Sigma(1, sigma)


class Ranges:
    """Pseudoranges and Doppler rates of an epoch, ready to become factors."""

    def __init__(
        self,
        observed: Observed,
        x: Vector,
        ionosphere: Vector,
        config: FusionConfig,
        detector: DetectorConfig,
    ) -> None:
        r_ecef_m = x[:3]
        predicted = predict_ranges(
            observed.states, r_ecef_m, np.zeros(3), observed.tow_s, ionosphere
        )
        elevation, azimuth = predicted[:, 5], predicted[:, 6]
        lat, lon, height = geodetic(r_ecef_m)
        delay = [
            troposphere_m(lat, height, el)
            + klobuchar_m(lat, lon, az, el, observed.tow_s, ionosphere)
            for el, az in zip(elevation, azimuth, strict=True)
        ]
        self.observed = observed
        self.los = predicted[:, 2:5]
        self.still_mps = predicted[:, 1]
        offset_m = np.where(observed.galileo, x[X_ISB], 0.0)
        self.corrected_m = observed.pseudorange_m - np.array(delay) - offset_m
        self._white_m = detector.sigma.sigma_m(elevation, observed.cn0_dbhz)
        self._slow = config.slow
        self.sigma_m = config.correlation * self._white_m
        self.sigma_mps = detector.sigma.rate_mps / np.sqrt(np.sin(np.maximum(elevation, 0.1)))
        self.above = elevation >= np.radians(detector.mask_deg)
        self._robust = config.robust
        self._doppler = detector.doppler

    def factors(self, epoch: int, frame: Frame, weights: dict[str, float]) -> dict[str, list[Any]]:
        """Factors by satellite, of those with a weight."""
        nav = gtsam.Pose3(gtsam.Rot3(frame.axes.T), frame.anchor_m)
        made = {}
        for i, name in enumerate(self.observed.satellites):
            share = weights.get(name, 0.0)
            if self.above[i] and share >= LEAST_WEIGHT:
                made[name] = self._of(i, epoch, frame, nav, 1.0 / np.sqrt(share))
        return made

    def slow_covariance(self, weights: dict[str, float]) -> Vector | None:
        """Covariance (3, 3) in ECEF of what averaging cannot take away; None if undetermined.

        Multipath, ephemeris and atmosphere stay the same for minutes: a bias of `slow` sigmas per
        satellite, which the position follows as the snapshot solution does.
        """
        names = self.observed.satellites
        used = self.above & np.array([weights.get(n, 0.0) >= LEAST_WEIGHT for n in names], bool)
        galileo = self.observed.galileo[used]
        if used.sum() < 4 + int(0 < galileo.sum() < len(galileo)):
            return None
        sigma = self._slow * self._white_m[used]
        design = design_matrix(self.los[used], galileo) / sigma[:, None]
        result: Vector = np.linalg.pinv(design.T @ design)[:3, :3]
        return result

    def _of(self, i: int, epoch: int, frame: Frame, nav: Any, widened: float) -> list[Any]:
        state, pose = self.observed.states[i], key("x", epoch)
        clock = key("c", epoch)
        noise = self._loss(sigma1(widened * self.sigma_m[i]))
        made: list[Any] = [
            gtsam.PseudorangeFactorArm(
                pose,
                clock,
                self.corrected_m[i],
                state[:3],
                NO_ARM,
                nav,
                state[6] / LIGHT_MPS,
                noise,
            )
        ]
        rate_mps = self.observed.doppler_mps[i]
        if self._doppler and np.isfinite(rate_mps):
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([widened * self.sigma_mps[i]]))
            toward = -self.los[i] @ frame.axes.T
            seen = np.array([rate_mps - self.still_mps[i]])
            row = gtsam.JacobianFactor(
                key("v", epoch), toward[None, :], key("d", epoch), LIGHT, seen, noise
            )
            made.append(gtsam.LinearContainerFactor(row, self._origin(epoch)))
        return made

    @staticmethod
    def _origin(epoch: int) -> Any:
        """Rates are linear in velocity and drift: the factor holds from zero on."""
        point = gtsam.Values()
        point.insert(key("v", epoch), np.zeros(3))
        point.insert(key("d", epoch), 0.0)
        return point

    def _loss(self, noise: Any) -> Any:
        estimator = gtsam.noiseModel.mEstimator
        if self._robust == "huber":
            return gtsam.noiseModel.Robust.Create(estimator.Huber.Create(HUBER), noise)
        if self._robust == "geman-mcclure":
            return gtsam.noiseModel.Robust.Create(estimator.GemanMcClure.Create(GEMAN), noise)
        return noise


def linear(terms: list[tuple[int, float]], sigma: float) -> Any:
    """A factor that keeps the sum of scalars times numbers at zero."""
    point = gtsam.Values()
    jacobian: Any = gtsam.JacobianFactor
    parts: list[Any] = []
    for name, factor in terms:
        point.insert(name, 0.0)
        parts += [name, np.array([[factor]])]
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma]))
    return gtsam.LinearContainerFactor(jacobian(*parts, np.zeros(1), noise), point)


def clock_factors(
    before: int, epoch: int, dt_s: float, jumped_s: float, detector: DetectorConfig
) -> list[Any]:
    """The receiver's clock from one epoch to the next; `jumped_s` is how far it may have leapt."""
    noise, root = detector.noise, np.sqrt(dt_s)
    walk_s = np.hypot(noise.clock_m * root, noise.drift_mps * dt_s * root) / LIGHT_MPS
    c0, c1, d0, d1 = key("c", before), key("c", epoch), key("d", before), key("d", epoch)
    return [
        linear([(c1, 1.0), (c0, -1.0), (d0, -dt_s)], float(np.hypot(walk_s, jumped_s))),
        linear([(d1, 1.0), (d0, -1.0)], noise.drift_mps * float(root) / LIGHT_MPS),
    ]


def baro_factor(epoch: int, altitude_m: float, config: FusionConfig) -> Any:
    """A pressure altitude; GTSAM wants the pressure of its own standard atmosphere for it."""
    pressure = gtsam.BarometricFactor().baroOut(altitude_m)
    return gtsam.BarometricFactor(key("x", epoch), key("h", epoch), pressure, sigma1(config.baro_m))


def mag_factor(epoch: int, field_b_gauss: Vector, frame: Frame, config: FusionConfig) -> Any:
    """The field in body axes against the world's magnetic model."""
    field = frame.field_gauss()
    size = float(np.linalg.norm(field))
    noise = gtsam.noiseModel.Isotropic.Sigma(3, config.mag_gauss)
    return gtsam.MagPoseFactorPose3(
        key("x", epoch), field_b_gauss, size, field / size, np.zeros(3), noise
    )


def airspeed_factor(epoch: int, speed_mps: float, config: FusionConfig) -> Any:
    """The speed through the air: the length of velocity less wind."""
    velocity, wind = key("v", epoch), key("w", epoch)

    def error(_: Any, values: Any, jacobians: Any) -> Vector:
        air = values.atPoint3(velocity) - values.atPoint3(wind)
        size = max(float(np.linalg.norm(air)), 1e-3)
        if jacobians is not None:
            jacobians[0] = (air / size)[None, :]
            jacobians[1] = -(air / size)[None, :]
        return np.array([size - speed_mps])

    return gtsam.CustomFactor(sigma1(config.airspeed_mps), [velocity, wind], error)
