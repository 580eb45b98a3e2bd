"""Timing faults of frames: delay, jitter, reordering, duplication."""

import math
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.fault_parts.rules import Drawn, Effect, Numbers, RuleLinkFault, link_rule
from mavproxy_fault.faults.loss import Share, ShareFault

UNIFORM, NORMAL, EXPONENTIAL, PARETO = range(4)
DISTRIBUTIONS: dict[str, tuple[int, Drawn]] = {
    "uniform": (UNIFORM, "random"),
    "normal": (NORMAL, "standard_normal"),
    "exponential": (EXPONENTIAL, "standard_exponential"),
    "pareto": (PARETO, "standard_exponential"),
}


@link_rule
def choose_share(t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float) -> int:
    """Return `p[at + 1]` for a share of the frames."""
    return int(p[at + 1]) if p[at] >= 1.0 or u < p[at] else 0


class Delay(RuleLinkFault, frozen=True, kw_only=True):
    """Delay every frame by `value` seconds."""

    name: ClassVar[str] = "delay"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}
    rule = staticmethod(choose_share)

    value: Seconds

    def numbers(self) -> Numbers:
        """Return the share of the frames (all) and the delay, microseconds."""
        return 1.0, float(round(self.value * 1e6))


@link_rule
def delay_at_random(
    t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float
) -> int:
    """Delay by a random time; the last frame is due at `m[place]`."""
    distribution, value_s = p[at], p[at + 1]
    late_s = value_s * u
    if distribution == NORMAL:  # clipped: a frame cannot be sent before it arrives
        late_s = max(late_s, 0.0)
    elif distribution == PARETO:
        late_s = value_s * math.expm1(u / p[at + 3])
    late_us = float(round((p[at + 2] + late_s) * 1e6))
    # It would overtake the previous frame, so it waits for that one.
    if p[at + 4] and t_us + late_us < m[place]:
        late_us = m[place] - t_us
    m[place] = max(m[place], t_us + late_us)
    return int(late_us)


class Jitter(RuleLinkFault, frozen=True, kw_only=True):
    """Delay frames by `base_s` plus a random time.

    `value` is the largest delay (uniform), the mean (exponential), the sigma (normal, clipped at
    zero), or the scale (Pareto of `shape`, heavy-tailed). With `keep_order` no frame overtakes
    another.
    """

    name: ClassVar[str] = "jitter"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}
    rule = staticmethod(delay_at_random)
    remembers: ClassVar[int] = 1

    value: Seconds
    distribution: Literal["uniform", "normal", "exponential", "pareto"] = "uniform"
    base_s: Seconds = 0.0
    shape: Annotated[float, Meta(gt=1)] = 3.0
    keep_order: bool = True

    @property
    def drawn(self) -> Drawn:  # type: ignore[override]
        """The unscaled number of the distribution."""
        return DISTRIBUTIONS[self.distribution][1]

    def numbers(self) -> Numbers:
        """Return the distribution's number and its parameters."""
        kind = DISTRIBUTIONS[self.distribution][0]
        return float(kind), self.value, self.base_s, self.shape, float(self.keep_order)


class Reorder(RuleLinkFault, frozen=True, kw_only=True):
    """Delay a fraction `value` of the frames by `by_s`, so that later ones overtake them."""

    name: ClassVar[str] = "reorder"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "by_s": 0.02}
    rule = staticmethod(choose_share)
    drawn: ClassVar[Drawn] = "random"

    value: Share = 0.1
    by_s: Seconds = 0.05

    def numbers(self) -> Numbers:
        """Return the share of the frames and the delay, microseconds."""
        return self.value, float(round(self.by_s * 1e6))


class Duplicate(ShareFault, frozen=True, kw_only=True):
    """Repeat a fraction `value` of the frames: `copies` more, the last `by_s` later."""

    name: ClassVar[str] = "duplicate"
    example: ClassVar[dict[str, Any]] = {"copies": 2, "by_s": 0.01}
    rule = staticmethod(choose_share)
    effect: ClassVar[Effect] = "copies"

    copies: Annotated[int, Meta(ge=1, le=100)] = 1
    by_s: Seconds = 0.0

    def numbers(self) -> Numbers:
        """Return share, number of copies, and the delay of the last one, microseconds."""
        return self.value, float(self.copies), float(round(self.by_s * 1e6))
