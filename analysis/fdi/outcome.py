"""What the detector found at one epoch, before it is put in words."""

from collections.abc import Mapping, Sequence

from analysis.fdi.core import Core
from analysis.fdi.slow import SlowVerdict
from analysis.fdi.value import Value


class Outcome(Value, frozen=True):
    """The core after an epoch and what the epoch said; nothing but `reason` where it could not be
    tested.

    `names` are the satellites that were used, `left_out` the places of those found faulty among
    them, `others` those left out before; innovations `residual_m` and `normalised` are of both. The
    tests: the main one, `parity` over `parity_dof` degrees of freedom, the rates' over `rate_dof`
    (None: there were too few), and the slow one.
    """

    core: Core
    reason: str = ""
    names: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()
    others: tuple[str, ...] = ()
    residual_m: Sequence[float] = ()
    normalised: Sequence[float] = ()
    statistic: float = 0.0
    threshold: float = 0.0
    probabilities: Mapping[str, float] = {}
    parity: float = 0.0
    parity_dof: int = 0
    rate: float | None = None
    rate_threshold: float | None = None
    rate_dof: int = 0
    slow: SlowVerdict | None = None
    hypothesis: str = "untestable"
    alarm: bool = False
    imu_blamed: bool = False
    was_inertial: bool = False
