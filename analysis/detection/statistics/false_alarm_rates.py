"""How often the detector's tests may raise a false alarm."""

from typing import Annotated

import msgspec
from msgspec import Meta

Probability = Annotated[float, Meta(gt=0, lt=0.5)]


class FalseAlarmRates(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """False-alarm probabilities, each per GNSS epoch.

    `p_false_alarm` is that of the main test F00, `p_slow` that of the tests with memory, `p_other`
    that of the Doppler rates and of the other sensors.
    """

    p_false_alarm: Probability = 1e-4
    p_slow: Probability = 1e-4
    p_other: Probability = 1e-5
