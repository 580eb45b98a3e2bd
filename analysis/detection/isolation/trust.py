"""Which sources the detector believes, from epoch to epoch."""

from analysis.detection.isolation.exclusion import Exclusions
from analysis.detection.receiver.carry_off_windows import CarryOff
from analysis.detection.values import Value
from analysis.samples.sample import Vector

NO_EXCLUSIONS: Exclusions = {}
NO_RATE_FAULTS: dict[str, int] = {}
LEAST_START_DOF = 2  # with one degree of freedom a start detects a fault, but isolates none
TRUSTED_DOF = 3  # with fewer the rest is not tested after one satellite is left out
CONFIRMING_EPOCHS = 10  # at 1 Hz the satellites move 39 km meanwhile: another geometry


def awaited_confirmation(to_confirm: int) -> str:
    """What a start with one degree of freedom waits for; empty if it is confirmed."""
    if not to_confirm:
        return ""
    epochs = "1 epoch" if to_confirm == 1 else f"{to_confirm} epochs"
    return (
        "a start with 1 degree of freedom:"
        f" no bound before {epochs} with more satellites or with Doppler agree"
    )


class Trust(Value, frozen=True):
    """The excluded satellites, and knowledge of faults that all satellites share.

    `excluded` are satellites (or the receiver) that are not used. No epoch could be explained since
    `unexplained_since_us` (None: the last one was). `distrusted` says what of all satellites
    together was wrong at the last epoch: "ranges", "rates" or nothing; `carry_off` is how they, or
    a receiver, were carried off when they were excluded. `jump_m` (3,) is how far all satellites
    have jumped together while it is unknown which place is right. `unbounded` says that the filter
    may follow a wrong source, `misled` that it follows satellites that were found to be wrong all
    together. `rate_faults` counts the epochs in a row in which a satellite's Doppler rate alone was
    wrong. `to_confirm` is how many epochs must still agree with a start that could not be tested
    well, before its position has a bound. `contradicting` are the first letters of excluded systems
    that contradict the one in use, where it is unknown which is wrong.
    """

    excluded: Exclusions = NO_EXCLUSIONS
    unexplained_since_us: int | None = None
    distrusted: str = ""
    carry_off: CarryOff | None = None
    jump_m: Vector | None = None
    unbounded: bool = False
    misled: bool = False
    rate_faults: dict[str, int] = NO_RATE_FAULTS
    to_confirm: int = 0
    contradicting: str = ""
