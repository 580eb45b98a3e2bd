"""A velocity shift that all Doppler rates share: it has three parameters, so it is detected early.

It is compared with this flight's own level (docs/fdi.md, "Without raw ranges", has the equation). A
large one only raises the suspicion that all satellites lead the filter away; `imu_or_satellites`
then decides, at this epoch and the following ones.
"""

from typing import NamedTuple

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.information import NormalEquations, covariance_block
from analysis.detection.receiver.carry_off_windows import FIRST_WEIGHT
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.linear import invert_positive_definite

SHIFT_DOF = 3  # north, east, down
SUSPECTED_US = 3_000_000  # how long a suspicion lasts: slow drags show within it
MOST_WEIGHT = 150.0  # epochs, memory of the level: MEMORY_S at 5 Hz


class CommonShift(NamedTuple):
    """The usual level of the common velocity shift, and whether a shift is suspected.

    `level` is the mean square per degree of freedom over `weight` epochs that passed their tests.
    All satellites are suspected until `suspected_until_us`.
    """

    level: float = 1.0
    weight: float = FIRST_WEIGHT
    suspected_until_us: int = 0


def shift_statistic(p: Vector, rates: NormalEquations) -> float:
    """The statistic of the velocity that all rates share, before the covariance p (20, 20)."""
    cofactor = invert_positive_definite(rates.information)
    off = (cofactor @ rates.b)[:SHIFT_DOF]
    total = (cofactor + covariance_block(p, rates.states))[:SHIFT_DOF, :SHIFT_DOF].copy()
    return float(off @ invert_positive_definite(total) @ off)


def shift_stands_out(known: CommonShift, statistic: float, config: FilterConfig) -> bool:
    """Whether the statistic of an epoch exceeds this flight's noise."""
    return statistic > known.level * chi_square_threshold(SHIFT_DOF, config.p_other)


def shift_is_suspected(
    known: CommonShift, statistic: float, t_us: int, config: FilterConfig
) -> bool:
    """Whether all satellites are suspected, by the statistic of this epoch or of an earlier one."""
    return t_us < known.suspected_until_us or shift_stands_out(known, statistic, config)


def update_common_shift(
    known: CommonShift, statistic: float, t_us: int, config: FilterConfig
) -> CommonShift:
    """The level and suspicion after an epoch whose tests passed."""
    if shift_stands_out(known, statistic, config):
        return known._replace(suspected_until_us=t_us + SUSPECTED_US)
    if t_us < known.suspected_until_us:
        return known  # a suspected shift must not raise the level that it is compared with
    weight = min(known.weight + 1.0, MOST_WEIGHT)
    step = (statistic / SHIFT_DOF - known.level) / weight
    return known._replace(level=known.level + step, weight=weight)
