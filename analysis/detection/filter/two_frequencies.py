"""Ranges on two frequencies: the ionosphere-free combination [1]_, and a test of their difference.

The difference of a satellite's two ranges is ionosphere and delays of satellite and receiver, so it
changes slowly. A step in it is a fault of one of the two, and shows without any other satellite;
the innovation of the range in use shows which.

References
----------
.. [1] IS-GPS-200N, 20.3.3.3.3.3.
"""

from dataclasses import replace

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.measurement import EpochObservation, predict_innovations
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.orbits.broadcast import NOISE, free_share
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.constants import L1_HZ

# By satellite: mean difference of its ranges in m, the epochs it is of, and the last one's time.
Differences = dict[str, tuple[float, int, int]]
MOST_EPOCHS = 30  # of a mean: it knows the level to a fifth of the noise, and follows drifts
# Second bands, by system, whose group delays the broadcast messages give: those of L5, B1C and B2a
# are in messages that are not read (CNAV, B-CNAV), and without them metres are left. Not of QZSS:
# receivers delay its L2C and GPS's L2 P(Y) differently, and the two share a clock.
COMBINED = {"G": "2", "R": "2", "E": "57", "C": "6"}


def _shares(epoch: Epoch, second: Epoch) -> Vector:
    """The weight (n,) of the first range of each satellite in the combination, NaN without one."""
    first_hz = L1_HZ if epoch.carrier_hz is None else epoch.carrier_hz
    return free_share(first_hz, L1_HZ if second.carrier_hz is None else second.carrier_hz)


def ionosphere_free(epoch: Epoch) -> Epoch:
    """The epoch with the ionosphere-free ranges, of the satellites that have two; unchanged without
    a second frequency."""
    if epoch.second is None:
        return epoch
    share, signals = _shares(epoch, epoch.second), epoch.second.signals
    range_m = share * epoch.pseudorange_m + (1.0 - share) * epoch.second.pseudorange_m
    paired = zip(epoch.satellites, signals, strict=True)
    known = [signal[:1] in COMBINED.get(name[0], "") for name, signal in paired]
    free = replace(epoch, pseudorange_m=range_m, is_free=True)
    return free.select((np.isfinite(range_m) & known).nonzero()[0].tolist())


def compare_ranges(
    epoch: Epoch,
    observation: EpochObservation,
    motion: MotionEstimate,
    known: Differences,
    ionosphere: Vector,
    config: FilterConfig,
) -> tuple[list[SensorDecision], Differences]:
    """The satellites one of whose ranges is wrong, and the differences after the epoch; `isolated`
    where both are in use: the tests of a single one find its faults. `motion` is the filter at the
    last epoch."""
    second = epoch.second
    if second is None:
        return [], known
    x, t_us, found, new = motion.x.copy(), epoch.t_us, list[SensorDecision](), dict(known)
    x[:3] += x[3:6] * (t_us - motion.t_us) * 1e-6
    innovations = predict_innovations(observation, x, config.sigma, ionosphere)
    off_m = innovations.range_m - np.median(innovations.range_m)
    bound = two_sided_bound(config.p_other / len(off_m))
    # Of two ranges as noisy as each other.
    noise_m2 = 2.0 * innovations.variance / observation.measurements.packed[:, NOISE]
    share = _shares(epoch, second) if config.ionosphere_free else np.ones(len(epoch.satellites))
    for i, name in enumerate(observation.satellites):
        at = epoch.satellites.index(name)
        difference_m = second.pseudorange_m.item(at) - epoch.pseudorange_m.item(at)
        if np.isnan(difference_m):
            continue
        mean_m, count, last_us = known.get(name, (difference_m, 0, t_us))
        if t_us - last_us > config.sigma.slow_s * 1e6:  # what lasts is the level
            mean_m, count = difference_m, 0
        step_m = difference_m - mean_m
        if step_m**2 <= bound**2 * noise_m2.item(i) * (1.0 + 1.0 / max(count, 1)):
            count = min(count + 1, MOST_EPOCHS)
            new[name] = mean_m + step_m / count, count, t_us
            continue
        # An error of the first range is `share` times as large in the range in use.
        is_first = off_m.item(i) / step_m < 0.5 - share.item(at)
        wrong, other = (epoch, second) if is_first else (second, epoch)
        off = f"{-step_m if is_first else step_m:+.1f} m off that on {other.signals[at]}"
        text = f"its range on {wrong.signals[at]} is {off}"
        isolated = config.ionosphere_free
        found.append(
            pattern_alarm(t_us, "satellites", text, suspect=name, isolated=isolated, dof=1)
        )
    # Most of them at once: the receiver changed its delays.
    return ([], {}) if 2 * len(found) > len(off_m) else (found, new)
