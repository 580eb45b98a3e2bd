"""Lost frames: random, in bursts, by rate limit, or all of them."""

from typing import Annotated, Any, ClassVar

from msgspec import Meta

from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.fault_parts.rules import LOST, Drawn, Numbers, RuleLinkFault, link_rule

Share = Annotated[float, Meta(ge=0, le=1)]


@link_rule
def lose_share(t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float) -> int:
    """Lose a share of the frames."""
    return LOST if p[at] >= 1.0 or u < p[at] else 0


class ShareFault(RuleLinkFault, frozen=True, kw_only=True):
    """Base of faults that hit a fraction `value` of the frames, chosen at random."""

    value: Share = 1.0

    @property
    def drawn(self) -> Drawn:  # type: ignore[override]
        """No random number if every frame is hit."""
        return "random" if self.value < 1.0 else ""


class Drop(ShareFault, frozen=True, kw_only=True):
    """Drop frames at random; `value` is the fraction lost (default: all)."""

    name: ClassVar[str] = "drop"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(lose_share)


class Outage(RuleLinkFault, frozen=True, kw_only=True):
    """Drop all frames: communication is interrupted."""

    name: ClassVar[str] = "outage"
    example: ClassVar[dict[str, Any]] = {}
    rule = staticmethod(lose_share)

    def numbers(self) -> Numbers:
        """Return the share."""
        return (1.0,)


@link_rule
def lose_in_bad_state(
    t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float
) -> int:
    """Change the state (`m[place + 1]`, 1 if bad) at random, then lose the frame at random."""
    bad = u >= p[at + 1] if m[place + 1] else u < p[at]
    m[place + 1] = 1.0 if bad else 0.0
    return LOST if v < (p[at + 3] if bad else p[at + 2]) else 0


class GilbertElliott(RuleLinkFault, frozen=True, kw_only=True):
    """Drop frames in clusters: a channel with a good and a bad state.

    `to_bad` and `to_good` are the probabilities per frame of changing state; `loss_good` and
    `loss_bad` the fractions lost in each. On average to_bad / (to_bad + to_good) of the frames meet
    the bad state (E. O. Elliott, Bell System Technical Journal 42(5), 1963).
    """

    name: ClassVar[str] = "gilbert-elliott"
    example: ClassVar[dict[str, Any]] = {"to_bad": 0.2, "to_good": 0.2}
    rule = staticmethod(lose_in_bad_state)
    parameters: ClassVar[tuple[str, ...]] = ("to_bad", "to_good", "loss_good", "loss_bad")
    remembers: ClassVar[int] = 2
    drawn: ClassVar[Drawn] = "random"
    draw_count: ClassVar[int] = 2  # one for the state and one for the loss

    to_bad: Share = 0.01
    to_good: Share = 0.2
    loss_good: Share = 0.0
    loss_bad: Share = 1.0


@link_rule
def lose_burst(t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float) -> int:
    """Lose the frame if a burst goes on or begins; `m[place + 1]` frames of it remain."""
    if not m[place + 1] and u < p[at]:
        m[place + 1] = p[at + 1]
    if not m[place + 1]:
        return 0
    m[place + 1] -= 1.0
    return LOST


class Burst(RuleLinkFault, frozen=True, kw_only=True):
    """Drop bursts of `frames` in a row; `value` is the probability per frame that one begins."""

    name: ClassVar[str] = "burst-loss"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "frames": 3}
    rule = staticmethod(lose_burst)
    parameters: ClassVar[tuple[str, ...]] = ("value", "frames")
    remembers: ClassVar[int] = 2
    drawn: ClassVar[Drawn] = "random"

    value: Share = 0.01
    frames: Annotated[int, Meta(ge=1)] = 10


@link_rule
def limit_rate(t_us: float, p: Numbers, at: int, m: Any, place: int, u: float, v: float) -> int:
    """Send, queue or lose the frame; the queue is empty at `m[place]`, which is its only state."""
    due_us = max(m[place], t_us)
    if due_us - t_us > p[at + 1]:
        return LOST
    m[place] = due_us + p[at]
    return int(due_us - t_us)


class RateLimit(RuleLinkFault, frozen=True, kw_only=True):
    """Limit the rate to `value` frames per second; queue up to `queue_s`, then drop frames."""

    name: ClassVar[str] = "rate-limit"
    example: ClassVar[dict[str, Any]] = {"value": 20}
    rule = staticmethod(limit_rate)
    remembers: ClassVar[int] = 1

    value: Annotated[float, Meta(ge=1e-6)]
    queue_s: Seconds = 0.0

    def numbers(self) -> Numbers:
        """Return the interval of frames and the longest delay, microseconds."""
        return float(round(1e6 / self.value)), self.queue_s * 1e6
