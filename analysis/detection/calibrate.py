"""The sigma model from clean data: scaled until the clean chi-square per degree of freedom is one.

The shape over elevation and C/N0 is fitted to the leave-one-out residuals first: their variance is
regressed on the model's three terms with coefficients of 0 or more. Then `scale` is set so that the
parity test, which asks satellites alone, has a mean of 1 per degree of freedom, and the rates'
sigma so that the median of their test has that of chi-square. Offsets are neither learnt nor taken
off meanwhile: the noise is that of the raw ranges.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace
from scipy.optimize import nnls
from scipy.special import chdtri

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector import Detector
from analysis.detection.detector_state import DetectorState
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.detection.filter.range_noise import SigmaModel
from analysis.results import Decision, SensorDecision
from analysis.samples.sample import Epoch, Sample, Vector
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document, write_yaml

LEAST_EPOCHS = 20
LEAST_FLOOR_M = 0.05
NEGLIGIBLE_P = 1e-100  # a false-alarm probability
OUTLIER_SIGMAS = 5.0  # residuals beyond this many sigma are no noise


@dataclass(frozen=True, slots=True)
class SigmaCalibration:
    """A sigma model and the data that it was fitted to."""

    sigma: SigmaModel
    epochs: int
    chi_square_per_dof: float


def calibrate_sigma(samples: Iterable[Sample], config: DetectorConfig) -> SigmaCalibration:
    """Fit the sigma model to a recording without faults.

    Raises
    ------
    ConfigError
        If there are fewer than 20 epochs that can be tested.
    """
    kept = list(samples)
    # What the recording is fitted with remembers nothing; `slow` is put back at the end.
    wanted, config = config, _memoryless(config)
    rows, decisions, rates = _pass(kept, config)
    if len(decisions) < LEAST_EPOCHS:
        raise ConfigError(
            f"calibrate: {len(decisions)} epochs can be tested; at least {LEAST_EPOCHS} are needed"
        )
    shaped = _shape(rows, config.sigma)
    # The second pass weighs with the fitted shape: only a scale is left to find.
    _, decisions, _ = _pass(kept, replace(config, sigma=shaped))
    ratio = _per_dof(decisions)
    scaled = replace(shaped, scale=shaped.scale * float(np.sqrt(ratio)))
    if rates:
        dof = float(np.median([dof for _, dof in rates]))
        # The median of chi-square: outliers of the rates do not move it.
        expected = float(chdtri(dof, 0.5))
        measured = float(np.median([statistic for statistic, _ in rates]))
        factor = float(np.sqrt(measured / expected))
        # A floor: no receiver's rates are better than that for long.
        scaled = replace(scaled, rate_mps=max(config.sigma.rate_mps * factor, 0.02))
    _, decisions, _ = _pass(kept, replace(config, sigma=scaled))
    return SigmaCalibration(
        replace(scaled, slow=wanted.sigma.slow), len(decisions), _per_dof(decisions)
    )


def _memoryless(config: DetectorConfig) -> DetectorConfig:
    """The configuration without tests that have a memory, which is what they would remember."""
    return replace(config, p_slow=NEGLIGIBLE_P, sigma=replace(config.sigma, slow=0.0))


def _per_dof(decisions: list[Decision]) -> float:
    total = sum(d.parity_statistic or 0.0 for d in decisions)
    return total / max(sum(d.parity_dof for d in decisions), 1)


def _pass(
    samples: list[Sample], config: DetectorConfig
) -> tuple[list[Vector], list[Decision], list[tuple[float, int]]]:
    """Residuals with elevation and C/N0 (3, n) by epoch, the decisions, and the rates' tests."""
    detector = Detector(config)
    state = detector.new_state()
    rows, decisions, rates = [], [], []
    for sample in samples:
        results, state = detector.step(sample, state)
        for result in results:
            # Alarmed epochs hold what is no noise.
            if isinstance(result, Decision) and result.parity_dof and not result.alarm:
                decisions.append(result)
                if isinstance(sample, Epoch):
                    rows.append(_residuals(sample, state, config))
            elif isinstance(result, SensorDecision) and result.statistic is not None:
                rates.append((result.statistic, result.dof))
    return rows, decisions, rates


def _residuals(epoch: Epoch, state: DetectorState, config: DetectorConfig) -> Vector:
    core = state.core
    selection = core.broadcast.selection
    observation = observe_epoch(epoch, selection) if selection is not None else None
    if observation is None or core.motion is None:
        return np.empty((3, 0))
    ionosphere = core.broadcast.ionosphere
    innovations = predict_innovations(observation, core.motion.x, config.sigma, ionosphere)
    # Satellites that were excluded are no noise either.
    keep = np.array([name not in core.trust.excluded for name in observation.satellites])
    keep &= innovations.elevation_rad >= np.radians(config.mask_deg)
    keep &= np.abs(innovations.range_m) < OUTLIER_SIGMAS * np.sqrt(innovations.variance)
    return np.array(
        [innovations.range_m[keep], innovations.elevation_rad[keep], observation.cn0_dbhz[keep]]
    )


def _shape(rows: list[Vector], before: SigmaModel) -> SigmaModel:
    """The model's three terms from squared residuals, by least squares without negative terms."""
    table = np.hstack(rows)
    # 45 dBHz where C/N0 is not given, as the model itself does.
    cn0 = np.where(np.isfinite(table[2]), table[2], 45.0)
    terms = np.column_stack(
        [
            np.ones(table.shape[1]),
            # 0.05 rad keeps the term finite at the horizon, as in the model.
            np.sin(np.maximum(table[1], 0.05)) ** -2.0,
            10.0 ** ((45.0 - cn0) / 10.0),
        ]
    )
    # a squared residual's own spread is its mean: weigh by the model so far
    weight = 1.0 / before.sigma_m(table[1], table[2]) ** 2
    found, _ = nnls(terms * weight[:, None], table[0] ** 2 * weight)
    # Coefficients are variances.
    floor, zenith, thermal = np.sqrt(found)
    return replace(
        before,
        scale=1.0,
        # A floor of zero would trust a strong satellite in the zenith without limit.
        floor_m=max(float(floor), LEAST_FLOOR_M),
        zenith_m=float(zenith),
        thermal_m=float(thermal),
    )


class SigmaFile(msgspec.Struct, frozen=True):
    """A file with a sigma model, as the monitor's section of a scenario may have it too."""

    sigma: SigmaModel


def write_sigma(path: Path, calibration: SigmaCalibration) -> None:
    """The sigma model as YAML, as the `sigma` of a monitor's configuration."""
    numbers = msgspec.structs.asdict(calibration.sigma).items()
    # Four digits: what a recording can tell.
    text = write_yaml({"sigma": {name: round(value, 4) for name, value in numbers}})
    made = f"{calibration.epochs} epochs, chi-square per dof {calibration.chi_square_per_dof:.3f}"
    path.write_text(f"# Pseudorange noise fitted to a clean recording: {made}\n{text}")


def read_sigma(path: Path) -> SigmaModel:
    """A sigma model as `write_sigma` wrote it.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds something else.
    """
    document = read_document(path)
    if not isinstance(document.data, dict) or "sigma" not in document.data:
        raise ConfigError(f"{path}: has no `sigma`; a file of `monitor --calibrate` has one")
    return decode(document, SigmaFile).sigma
