"""Timing faults of frames: delay, jitter, reordering, duplication."""

import math
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.fault_parts.rules import (
    Drawn,
    Effect,
    Numbers,
    ProfiledLinkFault,
    RuleLinkFault,
    link_rule,
    repeated_draw,
)
from mavproxy_fault.faults.loss import Correlation, Share, choose_share

UNIFORM, NORMAL, EXPONENTIAL, PARETO, SAMPLES, PARETO_NORMAL = range(6)
DISTRIBUTIONS: dict[str, tuple[int, Drawn]] = {
    "uniform": (UNIFORM, "random"),
    "normal": (NORMAL, "standard_normal"),
    "exponential": (EXPONENTIAL, "standard_exponential"),
    "pareto": (PARETO, "standard_exponential"),
    "samples": (SAMPLES, "random"),
    "pareto-normal": (PARETO_NORMAL, "standard_normal"),
}
MOST_QUANTILES = 256  # of samples: the mean of an exponential's is then 0.3 % too large


def random_delay(p: Numbers, u: float) -> float:
    """Return the delay [us] of a drawn number."""
    distribution, value_s = p[0], p[1]
    late_s = value_s * u
    if distribution == PARETO:
        late_s = value_s * math.expm1(u / p[3])
    elif distribution == PARETO_NORMAL:  # the sum of both at one quantile
        tail = max(0.5 * math.erfc(u / math.sqrt(2.0)), 1e-300)
        late_s = value_s * (0.25 * u + tail ** (-1.0 / p[3]) - 1.0)
    elif distribution == SAMPLES:  # between two of the quantiles, which follow
        quantile = u * p[6]
        n = int(quantile)
        low, high = p[7 + n], p[8 + n]
        late_s = value_s * (low + (quantile - n) * (high - low))
    # Clipped: a frame cannot be sent before it arrives.
    return float(round(max(p[2] + late_s, 0.0) * 1e6))


@link_rule
def delay_at_random(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Delay by a random time; the last frame is due at `m[0]`."""
    distribution, correlation = p[0], p[5]
    if correlation:
        # `v` is of the same distribution; its quantile is uniform.
        if distribution in (NORMAL, PARETO_NORMAL):
            v = 0.5 + 0.5 * math.erf(v / math.sqrt(2.0))
        elif distribution in (EXPONENTIAL, PARETO):
            v = -math.expm1(-v)
        u = repeated_draw(u, v, correlation, m[1:])
    late_us = random_delay(p, u)
    # It would overtake the previous frame, so it waits for that one.
    if p[4] and t_us + late_us < m[0]:
        late_us = m[0] - t_us
    m[0] = max(m[0], t_us + late_us)
    return int(late_us)


class Delay(ProfiledLinkFault, frozen=True, kw_only=True):
    """Delay every frame by `value` seconds, or by a profile: a growing one, or a recorded one.

    With `keep_order` no frame overtakes another, even where a profile decreases suddenly.
    """

    name: ClassVar[str] = "delay"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}
    rule = staticmethod(delay_at_random)
    remembers: ClassVar[int] = 1
    certain: ClassVar[bool] = True

    value: Seconds | None = None
    keep_order: bool = False

    def numbers(self) -> Numbers:
        """Return those of a jitter of nothing."""
        return UNIFORM, 0.0, self.value or 0.0, 1.0, float(self.keep_order), 0.0


class RandomTime(ProfiledLinkFault, frozen=True, kw_only=True):
    """Base of faults with a random time, `base_s` and more, at least zero."""

    value: Seconds | None = None
    distribution: Literal[
        "uniform", "normal", "exponential", "pareto", "pareto-normal", "samples"
    ] = "uniform"
    base_s: Seconds = 0.0
    shape: Annotated[float, Meta(gt=1)] = 3.0
    samples: Annotated[tuple[Seconds, ...], Meta(max_length=MOST_QUANTILES)] = ()
    file: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.distribution == "samples") != (len(self.samples) > 1):
            raise ValueError("distribution: samples needs two or more samples, or a file of them")

    @property
    def drawn(self) -> Drawn:
        """The unscaled number of the distribution."""
        return DISTRIBUTIONS[self.distribution][1]

    def numbers_with(self, *own: float) -> Numbers:
        """Return the distribution's number, its parameters, two own ones, and quantiles."""
        quantiles = (float(len(self.samples) - 1), *sorted(self.samples)) if self.samples else ()
        return (
            float(DISTRIBUTIONS[self.distribution][0]), self.value or 0.0, self.base_s, self.shape,
            *own, *quantiles,
        )  # fmt: skip


class Jitter(RandomTime, frozen=True, kw_only=True):
    """Delay frames by `base_s` plus a random time.

    `value` is the largest delay (uniform), the mean (exponential), the sigma (normal), the scale
    (Pareto of `shape`, heavy-tailed; pareto-normal: and a quarter of a normal one), or a factor of
    recorded delays: `samples` in seconds, or those of `file`, one on a line. With the probability
    `correlation` a frame has the delay of the one before. With `keep_order` no frame overtakes
    another.
    """

    name: ClassVar[str] = "jitter"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}
    rule = staticmethod(delay_at_random)
    remembers: ClassVar[int] = 3

    correlation: Correlation = 0.0
    keep_order: bool = True

    def numbers(self) -> Numbers:
        """Return the numbers of the delay, whether it keeps the order, and the correlation."""
        return self.numbers_with(float(self.keep_order), self.correlation)


@link_rule
def wait_for_slot(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Let the frame leave in the next slot, at `m[1]`, which takes `m[2]` frames and `m[3]` bytes.

    A slot that is full is followed by another; a frame that comes later begins one.
    """
    slot_us = m[1] + random_delay(p, v) if min(m[2], m[3]) <= 0.0 else m[1]
    if slot_us < t_us:
        slot_us = t_us + random_delay(p, u)
    if slot_us != m[1]:
        m[1], m[2], m[3] = slot_us, p[4], p[5]
    m[2] -= 1.0
    m[3] -= size
    return int(slot_us - t_us)


class Slots(RandomTime, frozen=True, kw_only=True):
    """Let frames leave together, in slots at random times, as Wi-Fi and LTE do.

    The time to the next slot is `base_s` and a random one, as that of `jitter`. A slot takes at
    most `frames` and `bytes`; the others wait for the next one (netem's `slot`).
    """

    name: ClassVar[str] = "slots"
    example: ClassVar[dict[str, Any]] = {"value": 0.05}
    rule = staticmethod(wait_for_slot)
    remembers: ClassVar[int] = 4
    draw_count = 2

    frames: Annotated[int, Meta(ge=1)] | None = None
    bytes: Annotated[int, Meta(ge=1)] | None = None

    def numbers(self) -> Numbers:
        """Return the numbers of the time, and what a slot takes."""
        return self.numbers_with(self.frames or math.inf, self.bytes or math.inf)


def read_samples(file: Path) -> tuple[float, ...]:
    """Read the delays of a file, one on a line; of more than `MOST_QUANTILES`, so many quantiles.

    Raises
    ------
    ConfigError
        If it cannot be read or has another content.
    """
    try:
        found = sorted(float(line) for line in file.read_text(encoding="utf-8").split())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{error}; give a file with a delay in seconds on each line") from None
    steps = min(len(found), MOST_QUANTILES) - 1
    return (
        tuple(found[n * (len(found) - 1) // steps] for n in range(steps + 1)) if steps > 0 else ()
    )


@link_rule
def overtake(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Delay the chosen frames; with a gap all others, after `m[3]` of them."""
    share, by_us, correlation, gap = p[0], p[1], p[2], p[3]
    if correlation:
        u = repeated_draw(u, v, correlation, m[1:])
    chosen = share >= 1.0 or u < share
    if not gap:
        return int(by_us) if chosen else 0
    m[3] += 1.0
    if m[3] < gap or not chosen:
        return int(by_us)
    m[3] = 0.0
    return 0


class Reorder(RuleLinkFault, frozen=True, kw_only=True):
    """Delay a fraction `value` of the frames by `by_s`, so that later ones overtake them.

    With the probability `correlation` a frame shares the choice of the one before. `gap` makes it
    netem's reorder: all frames are delayed but for a fraction `value` of every `gap`-th.
    """

    name: ClassVar[str] = "reorder"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "by_s": 0.02}
    rule = staticmethod(overtake)
    remembers: ClassVar[int] = 4

    value: Share = 0.1
    by_s: Seconds = 0.05
    correlation: Correlation = 0.0
    gap: Annotated[int, Meta(ge=0)] = 0

    def numbers(self) -> Numbers:
        """Return share, delay, correlation and gap."""
        return self.value, float(round(self.by_s * 1e6)), self.correlation, float(self.gap)


class ShareFault(RuleLinkFault, frozen=True, kw_only=True):
    """Base of faults of a fraction `value` of the frames.

    With the probability `correlation` a frame shares the choice of the one before.
    """

    rule = staticmethod(choose_share)
    remembers: ClassVar[int] = 3

    value: Share = 1.0
    correlation: Correlation = 0.0


class Duplicate(ShareFault, frozen=True, kw_only=True):
    """Repeat a fraction `value` of the frames: `copies` more, the last `by_s` later.

    With the probability `correlation` a frame shares the choice of the one before.
    """

    name: ClassVar[str] = "duplicate"
    example: ClassVar[dict[str, Any]] = {"copies": 2, "by_s": 0.01}
    effect: ClassVar[Effect] = "copies"

    copies: Annotated[int, Meta(ge=1, le=100)] = 1
    by_s: Seconds = 0.0

    def numbers(self) -> Numbers:
        """Return share, number of copies, correlation, and the delay of the last one."""
        late_us = float(round(self.by_s * 1e6))
        return self.value, float(self.copies), self.correlation, late_us
