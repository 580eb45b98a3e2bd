"""Lost frames: random, in bursts, by rate limit, or all of them."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import LinkFault, Outgoing
from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator

Share = Annotated[float, Meta(ge=0, le=1)]


class Drop(LinkFault, frozen=True, kw_only=True):
    """Drop frames at random; `value` is the fraction lost (default: all)."""

    name: ClassVar[str] = "drop"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}
    on_ranges: ClassVar[bool] = True

    value: Share = 1.0

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Drop the frame at random."""
        # No random draw if every frame is lost.
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        return [], None


class Outage(LinkFault, frozen=True, kw_only=True):
    """Drop all frames: communication is interrupted."""

    name: ClassVar[str] = "outage"
    example: ClassVar[dict[str, Any]] = {}

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Drop the frame."""
        return [], None


class GilbertElliott(LinkFault, frozen=True, kw_only=True):
    """Drop frames in clusters: a channel with a good and a bad state.

    `to_bad` and `to_good` are the probabilities per frame of changing state; `loss_good` and
    `loss_bad` the fractions lost in each. On average to_bad / (to_bad + to_good) of the frames meet
    the bad state (E. O. Elliott, Bell System Technical Journal 42(5), 1963).
    """

    name: ClassVar[str] = "gilbert-elliott"
    example: ClassVar[dict[str, Any]] = {"to_bad": 0.2, "to_good": 0.2}

    to_bad: Share = 0.01
    to_good: Share = 0.2
    loss_good: Share = 0.0
    loss_bad: Share = 1.0

    def new_state(self, start_us: int) -> bool:
        """Return whether the channel is bad; it starts good."""
        return False

    def apply(
        self, frame: Frame | bytes, t_us: int, state: bool, rng: "Generator"
    ) -> tuple[list[Outgoing], bool]:
        """Change the state at random, then drop the frame at random."""
        # Always two draws per frame, so that the random stream is independent of the outcome.
        bad = rng.random() >= self.to_good if state else rng.random() < self.to_bad
        lost = rng.random() < (self.loss_bad if bad else self.loss_good)
        return ([] if lost else [Outgoing(t_us, frame)]), bad


class Burst(LinkFault, frozen=True, kw_only=True):
    """Drop bursts of `frames` in a row; `value` is the probability per frame that one begins."""

    name: ClassVar[str] = "burst-loss"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "frames": 3}

    value: Share = 0.01
    frames: Annotated[int, Meta(ge=1)] = 10

    def new_state(self, start_us: int) -> int:
        """Return the number of frames still to be dropped."""
        return 0

    def apply(
        self, frame: Frame | bytes, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Drop the frame if a burst is active or begins."""
        # No random draws during a burst.
        remaining = state or (self.frames if rng.random() < self.value else 0)
        return ([], remaining - 1) if remaining else ([Outgoing(t_us, frame)], 0)


class Bucket(NamedTuple):
    """The state of a rate limit: when the next frame may be sent."""

    free_us: int


class RateLimit(LinkFault, frozen=True, kw_only=True):
    """Limit the rate to `value` frames per second; queue up to `queue_s`, then drop frames."""

    name: ClassVar[str] = "rate-limit"
    example: ClassVar[dict[str, Any]] = {"value": 20}

    value: Annotated[float, Meta(ge=1e-6)]
    queue_s: Seconds = 0.0

    def new_state(self, start_us: int) -> Bucket:
        """Return a state in which the first frame may be sent at once."""
        return Bucket(start_us)

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Bucket, rng: "Generator"
    ) -> tuple[list[Outgoing], Bucket]:
        """Send, queue or drop the frame."""
        due_us = max(state.free_us, t_us)
        # The time at which the queue will be empty is its only state.
        if due_us - t_us > self.queue_s * 1e6:
            return [], state
        late_s = (due_us - t_us) * 1e-6 or None
        # None: a frame sent at once was not changed.
        return [Outgoing(due_us, frame, late_s)], Bucket(due_us + round(1e6 / self.value))
