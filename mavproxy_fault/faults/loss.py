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
def choose_share(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Return `p[1]` for a share of the frames, with the correlation `p[2]`."""
    if p[2]:
        u = repeated_draw(u, v, p[2], m[1:])
    return int(p[1]) if p[0] >= 1.0 or u < p[0] else 0


class Drop(ProfiledLinkFault, frozen=True, kw_only=True):
    """Drop frames at random; `value` is the fraction lost (default: all).

    With the probability `correlation` a frame shares the fate of the one before.
    """

    name: ClassVar[str] = "drop"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(choose_share)
    remembers: ClassVar[int] = 3
    default: ClassVar[float | None] = 1.0

    value: Share | None = None
    correlation: Correlation = 0.0

    def numbers(self) -> Numbers:
        """Return share, what becomes of it, and correlation."""
        return self.value or 0.0, float(LOST), self.correlation


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
def lose_in_lossy_states(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Change the state at random, then lose the frame in the states 3 and 4 (`m[1]` 2 and 3)."""
    state, to_burst, to_gap, to_passing, to_losing, to_single = m[1], p[0], p[1], p[2], p[3], p[4]
    if state == 0.0:
        state = 3.0 if u < to_single else 2.0 if u < to_single + to_burst else 0.0
    elif state == 1.0:
        state = 2.0 if u < to_losing else 1.0
    elif state == 2.0:
        state = 1.0 if u < to_passing else 0.0 if u < to_passing + to_gap else 2.0
    else:
        state = 0.0
    m[1] = state
    return LOST if state >= 2.0 else 0


class FourStateLoss(RuleLinkFault, frozen=True, kw_only=True):
    """Drop single frames and bursts in which some frames pass: netem's `loss state`.

    In the states 1 and 2 frames pass, in the gap between bursts and within one; in 3 and 4 they are
    lost, within a burst and alone. `p13` is the probability per frame to go from state 1 to 3, and
    so on (Salsano, Ludovici and Ordine, University of Rome, 2012; tc-netem(8)).
    """

    name: ClassVar[str] = "four-state-loss"
    example: ClassVar[dict[str, Any]] = {"p13": 0.1, "p31": 0.3, "p32": 0.3, "p23": 0.4}
    rule = staticmethod(lose_in_lossy_states)
    parameters: ClassVar[tuple[str, ...]] = ("p13", "p31", "p32", "p23", "p14")
    remembers: ClassVar[int] = 2

    p13: Share = 0.01
    p31: Share = 0.2
    p32: Share = 0.0
    p23: Share = 1.0
    p14: Share = 0.0

    def __post_init__(self) -> None:
        if max(self.p13 + self.p14, self.p31 + self.p32) > 1.0:
            raise ValueError("p13 + p14 and p31 + p32 must not exceed 1")


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
