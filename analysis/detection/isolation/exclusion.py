"""Which satellites stay excluded, and when they are readmitted."""

from dataclasses import dataclass, replace

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, ERROR_SIZE, X_CLOCK
from analysis.detection.filter.lasting_errors import lasting_variance
from analysis.detection.filter.measurement import Innovations
from analysis.detection.receiver.drift_return import HEALTHY_P
from analysis.detection.statistics.chi_square import two_sided_bound
from analysis.detection.values import Value
from analysis.samples.sample import Vector

# Of a system's satellites that look healthy once it is: some are noisy, and a few look healthy
# while a spoofer moves it (benchmarks/gnss_spoofs.py).
RETURNED_SHARE = 0.75
# A range error that is the same for so long, and this small, is multipath of a healthy satellite;
# it is estimated. Larger ones are faults. So nothing healthy is excluded for a minute.
STANDING_US, STANDING_SIGMAS = 45_000_000, 6.0


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A satellite that is not used: since when it is faulty, when that was found, and since when it
    has looked healthy again (None: it does not).

    `whole_system` says that it was excluded with its whole system, not for its own range,
    `by_difference` that only the difference of its two ranges showed it. `seen` are the epochs
    since it was found, the mean and the mean square of its innovations in m.
    """

    onset_us: int
    found_us: int
    healthy_since_us: int | None = None
    whole_system: bool = False
    seen: tuple[int, float, float] = (0, 0.0, 0.0)
    by_difference: bool = False

    def stands(self, t_us: int, sigma_m: float) -> bool:
        """Whether its error has been constant for long, and is no larger than multipath is."""
        _, mean_m, square_m2 = self.seen
        constant = square_m2 - mean_m**2 <= sigma_m**2
        small = abs(mean_m) <= STANDING_SIGMAS * sigma_m
        return t_us - self.found_us >= STANDING_US and constant and small


Exclusions = dict[str, Exclusion]  # by satellite


class ExcludedInnovations(Value, frozen=True):
    """Excluded satellites with their innovations (n,): in m, over their sigma, and over a sigma
    that includes lasting errors."""

    names: tuple[str, ...]
    range_m: Vector
    normalised: Vector
    lasting: Vector


NONE_EXCLUDED = ExcludedInnovations((), np.empty(0), np.empty(0), np.empty(0))


def innovations_of_excluded(
    names: tuple[str, ...], innovations: Innovations, before: MotionEstimate, after: MotionEstimate
) -> ExcludedInnovations:
    """Innovations of excluded satellites against the filter after the epoch, which does not use
    them; those given are against the filter `before`."""
    if not names:
        return NONE_EXCLUDED
    h, moved = innovations.geometry, np.zeros(ERROR_SIZE)
    # Attitude and biases lie in between; a range does not observe them.
    moved[:3] = after.x[:3] - before.x[:3]
    moved[CLOCK:] = after.x[X_CLOCK:] - before.x[X_CLOCK:]
    range_m = innovations.range_m - h @ moved
    variance = innovations.variance + ((h @ after.p) * h).sum(axis=1)
    lasting = range_m / np.sqrt(variance + lasting_variance(innovations, 1.0))
    return ExcludedInnovations(names, range_m, range_m / np.sqrt(variance), lasting)


def add_exclusions(
    excluded: Exclusions,
    names: tuple[str, ...],
    onset_us: int,
    found_us: int,
    whole_system: bool = False,
) -> Exclusions:
    """Exclude more satellites, faulty since `onset_us`; those excluded already stay as they are."""
    # The first onset stays: a second detection is of the same fault.
    new = {
        name: Exclusion(onset_us, found_us, None, whole_system)
        for name in names
        if name not in excluded
    }
    return {**excluded, **new} if new else excluded


def readmit_satellites(
    excluded: Exclusions, innovations: ExcludedInnovations, t_us: int, config: DetectorConfig
) -> tuple[Exclusions, dict[str, float]]:
    """The exclusions that remain after the innovations of an epoch, and the standing errors in m of
    satellites that are readmitted with them.

    A healthy satellite's innovation against a filter that does not use it is normal; the satellite
    is readmitted when that has been so for `readmit_s` without a break.
    """
    standing: dict[str, float] = {}
    if not excluded:
        return excluded, standing
    out = dict(excluded)
    bound = two_sided_bound(HEALTHY_P)
    # Over its own sigma: a satellite low over the horizon is noisier, not less healthy.
    healthy = (np.abs(innovations.normalised) <= bound).tolist()
    returned = _returned_systems(excluded, innovations, bound)
    for i, (name, is_healthy) in enumerate(zip(innovations.names, healthy, strict=True)):
        entry = out[name]
        if entry.whole_system:
            is_healthy = name[0] in returned and bool(abs(innovations.lasting[i]) <= bound)
        v_m, lasting = innovations.range_m.item(i), innovations.lasting.item(i)
        count, mean_m, square_m2 = entry.seen
        count += 1
        mean_m += (v_m - mean_m) / count
        square_m2 += (v_m**2 - square_m2) / count
        entry = replace(entry, seen=(count, mean_m, square_m2))
        since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
        # A break restarts the wait, and so does an epoch from before the fault was found.
        if not entry.whole_system and lasting and entry.stands(t_us, v_m / lasting):
            del out[name]
            standing[name] = mean_m
        elif not is_healthy or t_us < entry.found_us:
            out[name] = replace(entry, healthy_since_us=None)
        elif (t_us - since) * 1e-6 >= config.readmit_s:
            del out[name]
        else:
            out[name] = replace(entry, healthy_since_us=since)
    return out, standing


def _returned_systems(
    excluded: Exclusions, innovations: ExcludedInnovations, bound: float
) -> set[str]:
    """The systems that were excluded as a whole and most of whose satellites look healthy.

    A single satellite may look healthy because it lies across a spoofer's shift. Lasting errors are
    allowed for: no satellite was found faulty itself, and its learned offset is lost.
    """
    looks: dict[str, list[bool]] = {}
    for name, normalised in zip(innovations.names, innovations.lasting.tolist(), strict=True):
        if excluded[name].whole_system:
            looks.setdefault(name[0], []).append(abs(normalised) <= bound)
    return {
        system for system, healthy in looks.items() if sum(healthy) >= RETURNED_SHARE * len(healthy)
    }
