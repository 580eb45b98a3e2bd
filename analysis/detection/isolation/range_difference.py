"""The difference of a satellite's ranges on two frequencies, as a test of both.

It is ionosphere and delays of satellite and receiver, so it changes slowly. A step in it is a fault
of one of the two, and shows without any other satellite; the innovation of the range in use shows
which.
"""

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.measurement import (
    EpochObservation,
    predict_innovations,
    shares_of_first,
)
from analysis.detection.isolation.exclusion import Exclusion, Exclusions
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.sample import Epoch, Vector

# By satellite and second signal: mean difference of the ranges in m, the epochs it is of, and the
# last one's time.
Differences = dict[tuple[str, str], tuple[float, int, int]]
MOST_EPOCHS = 30  # of a mean: it knows the level to a fifth of the noise, and follows drifts


def compare_ranges(
    epoch: Epoch,
    observation: EpochObservation,
    motion: MotionEstimate,
    known: Differences,
    excluded: Exclusions,
    ionosphere: Vector,
    config: FilterConfig,
) -> tuple[list[SensorDecision], Differences, Exclusions]:
    """The satellites one of whose ranges is wrong, and the differences and exclusions after the
    epoch; they are excluded where both are in use: the tests of a single one find its faults.
    `motion` is the filter at the last epoch."""
    second, isolated = epoch.second, config.ionosphere_free
    if second is None:
        return [], known, excluded
    x, t_us, found, new, out = motion.x.copy(), epoch.t_us, [], dict(known), dict(excluded)
    x[:3] += x[3:6] * (t_us - motion.t_us) * 1e-6
    innovations = predict_innovations(observation, x, config.sigma, ionosphere)
    off_m = innovations.range_m - np.median(innovations.range_m)
    bound = two_sided_bound(config.p_other / len(off_m))
    places = [epoch.satellites.index(name) for name in observation.satellites]
    # Each range is as noisy as its own signal is weak; codeless tracking is weaker than noisy.
    codeless = [signal[1:] in ("W", "P") for signal in second.signals] | np.isnan(second.cn0_dbhz)
    both = epoch.cn0_dbhz, np.where(codeless, epoch.cn0_dbhz, second.cn0_dbhz)
    sigmas_m = [config.sigma.sigma_m(innovations.elevation_rad, cn0[places]) for cn0 in both]
    system = np.array(config.sigma.systems)[observation.measurements.system]
    noise_m2 = np.square(sigmas_m * system).sum(axis=0)
    share = shares_of_first(epoch, second)[places] if isolated else np.ones(len(places))
    for i, (name, at) in enumerate(zip(observation.satellites, places, strict=True)):
        difference_m = second.pseudorange_m.item(at) - epoch.pseudorange_m.item(at)
        if np.isnan(difference_m):
            continue
        key, entry = (name, second.signals[at]), out.get(name)
        mean_m, count, last_us = known.get(key, (difference_m, 0, t_us))
        if t_us - last_us > config.sigma.slow_s * 1e6:  # what lasts is the level
            mean_m, count = difference_m, 0
        step_m = difference_m - mean_m
        if step_m**2 <= bound**2 * noise_m2.item(i) * (1.0 + 1.0 / max(count, 1)):
            if entry and entry.by_difference and count:  # it is what it was before
                del out[name]
            count = min(count + 1, MOST_EPOCHS)
            new[key] = mean_m + step_m / count, count, t_us
            continue
        # An error of the first range is `share` times as large in the range in use.
        is_first = off_m.item(i) / step_m < 0.5 - share.item(i)
        wrong, other = (epoch, second) if is_first else (second, epoch)
        off = f"{-step_m if is_first else step_m:+.1f} m off that on {other.signals[at]}"
        text = f"its range on {wrong.signals[at]} is {off}"
        found.append(
            pattern_alarm(t_us, "satellites", text, suspect=name, isolated=isolated, dof=1)
        )
        if isolated and entry is None:
            out[name] = Exclusion(t_us, t_us, by_difference=True)
    # Most of them at once: the receiver changed its delays.
    return ([], {}, excluded) if 2 * len(found) > len(off_m) else (found, new, out)
