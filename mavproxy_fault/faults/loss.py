"""Lost frames: random, by wrong bits, in bursts, or all of them."""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.rules import (
    LOST,
    Numbers,
    ProfiledLinkFault,
    RuleLinkFault,
    link_rule,
    repeated_draw,
)

Share = Annotated[float, Meta(ge=0, le=1)]
Connection = Literal["kept", "closed", "reset", "refused"]
Correlation = Annotated[float, Meta(ge=0, lt=1)]


@link_rule
def lose_share(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Lose a share of the frames, correlated with a second parameter."""
    if p[1]:
        u = repeated_draw(u, v, p[1], m[1:])
    return LOST if p[0] >= 1.0 or u < p[0] else 0


class Drop(ProfiledLinkFault, frozen=True, kw_only=True):
    """Drop frames at random; `value` is the fraction lost (default: all).

    With the probability `correlation` a frame shares the fate of the one before.
    """

    name: ClassVar[str] = "drop"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(lose_share)
    remembers: ClassVar[int] = 3
    default: ClassVar[float | None] = 1.0

    value: Share | None = None
    correlation: Correlation = 0.0

    def numbers(self) -> Numbers:
        """Return share and correlation."""
        return self.value or 0.0, self.correlation


@link_rule
def lose_by_length(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Lose a frame of which one bit or more is wrong, as its receiver does."""
    return LOST if u >= (1.0 - p[0]) ** (8 * size) else 0


class BitErrors(ProfiledLinkFault, frozen=True, kw_only=True):
    """Drop the frames that the bit-error rate `value` spoils: the longer, the more of them."""

    name: ClassVar[str] = "bit-errors"
    example: ClassVar[dict[str, Any]] = {"value": 1e-3}
    rule = staticmethod(lose_by_length)

    value: Share | None = None

    def numbers(self) -> Numbers:
        """Return the rate."""
        return (self.value or 0.0,)


@link_rule
def lose_after_bytes(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Lose what exceeds a number of bytes, of which `m[1]` have come."""
    m[1] += size
    return LOST if m[1] > p[0] else 0


class Outage(RuleLinkFault, frozen=True, kw_only=True):
    """Drop all frames: communication is interrupted, at once or after so many bytes.

    Connections are `kept` (half-open: the peer does not notice), or TCP endpoints have them
    `closed`, `reset`, or reset and new ones `refused`.
    """

    name: ClassVar[str] = "outage"
    example: ClassVar[dict[str, Any]] = {}
    rule = staticmethod(lose_after_bytes)
    parameters: ClassVar[tuple[str, ...]] = ("after_bytes",)
    certain: ClassVar[bool] = True
    remembers: ClassVar[int] = 2

    after_bytes: Annotated[int, Meta(ge=0)] = 0
    connection: Connection = "kept"


@link_rule
def lose_in_bad_state(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Change the state (`m[1]`, 1 if bad) at random, then lose the frame at random."""
    bad = u >= p[1] if m[1] else u < p[0]
    m[1] = 1.0 if bad else 0.0
    return LOST if v < (p[3] if bad else p[2]) else 0


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
    draw_count = 2

    to_bad: Share = 0.01
    to_good: Share = 0.2
    loss_good: Share = 0.0
    loss_bad: Share = 1.0


@link_rule
def lose_burst(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Lose the frame if a burst goes on or begins; `m[1]` frames of it remain."""
    if not m[1] and u < p[0]:
        m[1] = p[1]
    if not m[1]:
        return 0
    m[1] -= 1.0
    return LOST


class Burst(RuleLinkFault, frozen=True, kw_only=True):
    """Drop bursts of `frames` in a row; `value` is the probability per frame that one begins."""

    name: ClassVar[str] = "burst-loss"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "frames": 3}
    rule = staticmethod(lose_burst)
    parameters: ClassVar[tuple[str, ...]] = ("value", "frames")
    remembers: ClassVar[int] = 2

    value: Share = 0.01
    frames: Annotated[int, Meta(ge=1)] = 10
