"""Learn the noise of pseudoranges from a recording itself: by elevation, C/N0 and system.

Each epoch is solved alone, robustly, so that a faulty satellite moves the solution little; the
model is fitted to the residuals of all epochs (docs/fdi.md, "Noise of the recording").
"""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector import Detector
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.measurement import EpochObservation, observe, predict_innovations
from analysis.detection.filter.range_noise import SigmaModel
from analysis.detection.stages.initial_fix import solve_snapshot
from analysis.orbits.broadcast import CLOCKS, NOISE, design_matrix, systems_of
from analysis.samples.block import Indices
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample, Sample, Vector
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document, write_yaml

# 20 epochs of eight satellites know a variance to a tenth; a quarter of 300 gives the same factors
# to 2 % on the walk and the roof (benchmarks/fdi.md).
LEAST_EPOCHS, MOST_EPOCHS = 20, 300
LEAST_IN_CELL = 30  # residuals: a robust variance of fewer is uncertain by a third
CELLS = (4, 3)  # of C/N0, of elevation
MOST_SIGMAS = 5.0  # that a residual counts for: a standing multipath has four
HUBER = 1.5  # sigmas: 95 % efficient for normal errors
# Of a residual that the solution leaves: one with less tests its own satellite alone
LEAST_OWN = 0.2
ROUNDS = 6  # of Huber's weights: twice as many change no factor by 2 %
VAGUE = 1e-9  # 1/m^2: keeps the geometry of few satellites regular
LEAST_FACTOR, MOST_FACTOR = 0.3, 12.0  # of the model: a simulated receiver has 0.4, telephones 7
LEAST_FLOOR_M = 0.05  # zero would trust a strong satellite in the zenith without limit
LEAST_RATE_MPS = 0.02  # no receiver's rates are better than that for long
# Of the variance that lasts from one epoch to the next but not for minutes, so that it counts: most
# of it. A code that slips by 24 m every 28 s has 0.65, a walk 0.46, roofs and stations at most 0.31
LEAST_LASTING = 0.5
LEAST_PAIRS = 100  # of residuals equally far apart: their correlation is known to a tenth
# Columns of `_residuals`.
SYSTEM, SINE, CN0, RESIDUAL, TIME, SATELLITE, COLUMNS = range(7)


@dataclass(frozen=True, slots=True)
class RecordedNoise:
    """A sigma model and the data it was learnt from."""

    sigma: SigmaModel
    epochs: int
    ranges: int
    chi_square_per_dof: float

    def describe(self) -> str:
        """The model in words."""
        s = self.sigma
        factors = ", ".join(f"{factor:.2f}" for factor in s.systems)
        lasting = f"; floor and zenith last {s.lasting_s:.0f} s" if s.lasting_s else ""
        return (
            f"learnt from {self.ranges} ranges of {self.epochs} epochs: floor {s.floor_m:.2f} m,"
            f" zenith {s.zenith_m:.2f} m, thermal {s.thermal_m:.2f} m at 45 dBHz, times {factors}"
            f" (GPS, Galileo, GLONASS, BeiDou); rates {s.rate_mps:.2f} m/s{lasting}"
        )


def learn_noise(samples: Iterable[Sample], config: DetectorConfig) -> RecordedNoise | None:
    """Learn the sigma model of a recording; None if fewer than 20 epochs can be solved."""
    rows, rates, epochs = _residuals(samples, config)
    if epochs < LEAST_EPOCHS:
        return None
    sine, cn0, residual = rows[:, SINE : RESIDUAL + 1].T
    system = rows[:, SYSTEM].astype(np.int64)
    before = config.sigma
    modelled = before.sigma_m(np.arcsin(sine), cn0)
    first = _system_factors(system, residual / modelled, before)
    own = residual / first[system]
    lasting_s, thermal_m = _lasting_noise(rows, own, modelled, before.slow_s)
    before = replace(before, lasting_s=lasting_s)
    shaped = _fit_shape(sine, cn0, own, modelled, before, thermal_m)
    sigma_m = shaped.sigma_m(np.arcsin(sine), cn0)
    factors = _system_factors(system, residual / sigma_m, before)
    # By system within the bounds, as the fitted terms may be larger or smaller than the model's.
    for kind in set(system.tolist()):
        grown = np.median((sigma_m / modelled)[system == kind])
        ratio = factors[kind] / before.systems[kind] * grown
        factors[kind] *= min(max(ratio, LEAST_FACTOR), MOST_FACTOR) / ratio
    gps, galileo, glonass, beidou = factors.round(4).tolist()
    learnt = replace(shaped, systems=(gps, galileo, glonass, beidou))
    if len(rates) >= LEAST_IN_CELL:
        learnt = replace(learnt, rate_mps=round(max(_scale(rates), LEAST_RATE_MPS), 4))
    squares = np.square(residual / (factors[system] * sigma_m))
    return RecordedNoise(learnt, epochs, len(rows), float(np.mean(np.minimum(squares, 25.0))))


def _lasting_noise(
    rows: Vector, residual: Vector, modelled: Vector, slow_s: float
) -> tuple[float, float]:
    """How long residuals stay correlated in s, and the thermal noise that does not last in m; zeros
    where little of them lasts. What stands for `slow_s` is a satellite's offset, and no noise."""
    normalised = residual / modelled
    limit = MOST_SIGMAS * _scale(normalised)
    normalised = np.clip(normalised, -limit, limit)
    total = float(np.mean(normalised**2))
    stretch = 1e6 * rows[:, SATELLITE] + rows[:, TIME] // slow_s
    _, place, counts = np.unique(stretch, return_inverse=True, return_counts=True)
    normalised -= (np.bincount(place, normalised) / counts)[place]
    order = np.lexsort((rows[:, TIME], rows[:, SATELLITE]))
    first = lasting_s = thermal_m = 0.0
    for apart in 2 ** np.arange(int(math.log2(len(order)))):
        one, other = order[:-apart], order[apart:]
        gap_s = rows[other, TIME] - rows[one, TIME]
        same = rows[one, SATELLITE] == rows[other, SATELLITE]
        # Epochs come in pairs: the next one is nearer than the first of the next pair.
        same &= gap_s <= 1.5 * np.min(gap_s, where=same, initial=math.inf)
        one, other = one[same], other[same]
        shared = float(np.mean(normalised[one] * normalised[other])) if len(one) else 0.0
        if apart == 1 and shared >= LEAST_LASTING * total:
            weakness = 10.0 ** ((45.0 - rows[one, CN0]) / 10.0)
            thermal_m = _scale((residual[other] - residual[one]) / np.sqrt(2.0 * weakness))
            first = shared
        if len(one) < LEAST_PAIRS or not first:
            break
        lasting_s = float(np.median(gap_s[same]))
        if shared < first / math.e:
            break
    return lasting_s, thermal_m


def _system_factors(system: Indices, normalised: Vector, before: SigmaModel) -> Vector:
    """The scale (4,) of each system; that of all of them where one has too few residuals."""
    found = np.array(before.systems)
    found *= _scale(normalised / found[system])
    for kind in range(CLOCKS):
        own = normalised[system == kind]
        if len(own) >= LEAST_IN_CELL:
            found[kind] = _scale(own)
    return found


def _residuals(samples: Iterable[Sample], config: DetectorConfig) -> tuple[Vector, Vector, int]:
    """Of ranges: system, sine of the elevation, C/N0, residual, time in s and a number of the
    satellite (n, 6); of rates the residuals in the zenith (m,); how many epochs these are of."""
    broadcast, epochs = Detector(config).new_state().core.broadcast, list[Epoch]()
    for sample in samples:
        if isinstance(sample, (EphemerisSample, IonosphereSample)):
            broadcast = broadcast.add(sample)
        elif isinstance(sample, Epoch):
            epochs.append(sample)
    tables, rates = [np.empty((0, COLUMNS))], [np.empty(0)]
    near: Vector | None = None
    step = 2 * max(len(epochs) // MOST_EPOCHS, 1)
    # In pairs: the next epoch shows what lasts.
    for epoch in (epoch for i, epoch in enumerate(epochs) if i % step < 2):
        observation, broadcast = observe(epoch, broadcast, config)
        if observation is None:
            continue
        start = np.zeros(X_SIZE) if near is None else near
        near = solve_snapshot(observation, start, config, broadcast.ionosphere)
        if near is not None:
            t_s = epoch.t_us * 1e-6
            found = list(_epoch_residuals(observation, near, config, broadcast.ionosphere, t_s))
            tables.extend(found[:1])
            rates.extend(found[1:])
    return np.vstack(tables), np.concatenate(rates), sum(len(table) > 0 for table in tables)


def _epoch_residuals(
    observation: EpochObservation,
    x: Vector,
    config: DetectorConfig,
    ionosphere: Vector,
    t_s: float,
) -> Iterator[Vector]:
    """The table of an epoch's ranges, and the residuals of its rates."""
    elevation = predict_innovations(observation, x, config.sigma, ionosphere).elevation_rad
    observation = observation.select(elevation >= config.mask_rad)
    system = observation.measurements.system
    if len(system) < 5 + len(systems_of(system)):
        return
    found = predict_innovations(observation, x, config.sigma, ionosphere)
    design = design_matrix(-found.geometry[:, 0:3], system)
    # Some metres from least squares of all: the geometry is the same.
    step, own = _robust_step(design, found.range_m, np.sqrt(found.variance))
    residual = found.range_m - design @ step
    known = own > LEAST_OWN
    sine, cn0 = np.sin(found.elevation_rad), observation.measurements.cn0_dbhz
    cn0 = np.where(np.isfinite(cn0), np.maximum(cn0, 0.0), 45.0)
    # A combination of two ranges counts as one of them.
    residual /= np.sqrt(np.maximum(own, LEAST_OWN) * observation.measurements.packed[:, NOISE])
    number = [100 * ord(name[0]) + int(name[1:]) for name in observation.satellites]
    yield np.column_stack([system, sine, cn0, residual, np.full(len(own), t_s), number])[known]
    heard = np.isfinite(found.rate_mps)
    if heard.sum() >= 6:
        design, root = design[heard, :4], np.sqrt(sine[heard])
        step, own = _robust_step(design, found.rate_mps[heard], 1.0 / root)
        left = (found.rate_mps[heard] - design @ step) * root
        yield (left / np.sqrt(np.maximum(own, LEAST_OWN)))[own > LEAST_OWN]


def _robust_step(design: Vector, v: Vector, sigma: Vector) -> tuple[Vector, Vector]:
    """The step of least squares with Huber's weights, and the share of each residual (n,) that the
    solution leaves."""
    weight, step = 1.0 / sigma**2, np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        weighted = design * weight[:, None]
        cofactor = np.linalg.inv(design.T @ weighted + VAGUE * np.eye(len(step)))
        step = cofactor @ (weighted.T @ v)
        over = np.abs(v - design @ step) / sigma
        limit = HUBER * max(float(np.median(over)) / 0.6745, 1e-6)
        weight = np.minimum(limit / np.maximum(over, limit), 1.0) / sigma**2
    return step, 1.0 - ((design @ cofactor) * weighted).sum(axis=1)


def _scale(residuals: Vector) -> float:
    """The root mean square of residuals none of which counts for more than five standard
    deviations by the upper quartile."""
    squares = np.square(residuals)
    variance = float(np.quantile(squares, 0.75)) / 1.3233  # chi-square's
    return math.sqrt(float(np.mean(np.minimum(squares, MOST_SIGMAS**2 * variance))))


def _fit_shape(
    sine: Vector,
    cn0: Vector,
    residual: Vector,
    modelled: Vector,
    before: SigmaModel,
    thermal_m: float,
) -> SigmaModel:
    """The model's three terms from robust variances in cells, by least squares without negative
    terms, where some noise lasts with the given thermal term; the terms as they are, where the
    recording has too few cells."""
    # 0.05 rad keeps the term finite at the horizon, as in the model.
    zenith, thermal = np.maximum(sine, math.sin(0.05)) ** -2.0, 10.0 ** ((45.0 - cn0) / 10.0)
    terms = np.column_stack([np.ones(len(sine)), zenith, thermal])
    rows, variances, weights = [], [], []
    for strong in np.array_split(np.argsort(cn0), CELLS[0]):
        for cell in np.array_split(strong[np.argsort(sine[strong])], CELLS[1]):
            if len(cell) >= LEAST_IN_CELL:
                mean = float(np.mean(modelled[cell] ** 2))
                # In units of the model, so that it changes little within the cell.
                variance = mean * _scale(residual[cell] / modelled[cell]) ** 2
                rows.append(terms[cell].mean(axis=0))
                variances.append(variance)
                weights.append(math.sqrt(len(cell)) / mean)
    if len(rows) < 2 * terms.shape[1]:
        return before
    weight = np.array(weights)
    a, b = np.array(rows) * weight[:, None], np.array(variances) * weight
    if before.lasting_s:
        lasting = _fit_positive(a[:, :2], b - thermal_m**2 * a[:, 2])
        found = np.append(lasting, thermal_m**2)
    else:
        found = _fit_positive(a, b)
    # As large as the model in the median: the factors of the systems then say how noisy they are.
    found *= np.median(modelled**2) / max(float(np.median(terms @ found)), 1e-9)
    floor_m, zenith_m, thermal_m = np.sqrt(found).round(4).tolist()
    floor_m = max(floor_m, LEAST_FLOOR_M)
    return replace(before, scale=1.0, floor_m=floor_m, zenith_m=zenith_m, thermal_m=thermal_m)


def _fit_positive(a: Vector, b: Vector) -> Vector:
    """Least squares without negative terms: the best fit of some terms that has none."""
    fits = [np.zeros(a.shape[1])]
    for some in itertools.product((False, True), repeat=a.shape[1]):
        fit = np.zeros(a.shape[1])
        fit[list(some)] = np.linalg.lstsq(a[:, some], b)[0]
        fits += [fit] if (fit >= 0.0).all() else []
    return min(fits, key=lambda fit: float(np.linalg.norm(a @ fit - b)))


class SigmaFile(msgspec.Struct, frozen=True):
    """A file with a sigma model, as the monitor's section of a scenario may have it too."""

    sigma: SigmaModel


def write_sigma(path: Path, learned: RecordedNoise) -> None:
    """The sigma model as YAML, as the `sigma` of a monitor's configuration."""
    text = write_yaml({"sigma": msgspec.structs.asdict(learned.sigma)})
    path.write_text(f"# Pseudorange noise {learned.describe()}\n{text}")


def read_sigma(path: Path) -> SigmaModel:
    """A sigma model as `write_sigma` wrote it.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds something else.
    """
    document = read_document(path)
    if not isinstance(document.data, dict) or "sigma" not in document.data:
        raise ConfigError(f"{path}: has no `sigma`; give a file that `monitor --calibrate` wrote")
    return decode(document, SigmaFile).sigma
