"""Lost frames: at random, in bursts, or all of them."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import LinkFault, Outgoing
from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator

Share = Annotated[float, Meta(ge=0, le=1)]


class Drop(LinkFault, frozen=True, kw_only=True):
    """Lose frames at random; `value` is the share that is lost, all by default."""

    name: ClassVar[str] = "drop"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}
    on_ranges: ClassVar[bool] = True

    value: Share = 1.0

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Lose this frame or not."""
        # No draw where every frame is lost: there is nothing to decide.
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        return [], None


class Outage(LinkFault, frozen=True, kw_only=True):
    """Lose everything: communication is interrupted."""

    name: ClassVar[str] = "outage"
    example: ClassVar[dict[str, Any]] = {}

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Nothing leaves."""
        return [], None


class GilbertElliott(LinkFault, frozen=True, kw_only=True):
    """A channel with a good and a bad state: losses come in clusters.

    `to_bad` and `to_good` are the chances, per frame, of changing state; `loss_good` and `loss_bad`
    the shares lost in each. In the long run to_bad / (to_bad + to_good) of the frames meet the bad
    state (E. O. Elliott, Bell System Technical Journal 42(5), 1963).
    """

    name: ClassVar[str] = "gilbert-elliott"
    example: ClassVar[dict[str, Any]] = {"to_bad": 0.2, "to_good": 0.2}

    to_bad: Share = 0.01
    to_good: Share = 0.2
    loss_good: Share = 0.0
    loss_bad: Share = 1.0

    def new_state(self, start_us: int) -> bool:
        """Whether the channel is bad: it starts good."""
        return False

    def apply(
        self, frame: Frame | bytes, t_us: int, state: bool, rng: "Generator"
    ) -> tuple[list[Outgoing], bool]:
        """Change state or not, then lose the frame or not."""
        # Two draws per frame, always: the stream of numbers does not hang on what happened.
        bad = rng.random() >= self.to_good if state else rng.random() < self.to_bad
        lost = rng.random() < (self.loss_bad if bad else self.loss_good)
        return ([] if lost else [Outgoing(t_us, frame)]), bad


class Burst(LinkFault, frozen=True, kw_only=True):
    """Now and then lose `frames` in a row; `value` is the chance that a burst begins at a frame."""

    name: ClassVar[str] = "burst-loss"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "frames": 3}

    value: Share = 0.01
    frames: Annotated[int, Meta(ge=1)] = 10

    def new_state(self, start_us: int) -> int:
        """How many frames are still to be lost."""
        return 0

    def apply(
        self, frame: Frame | bytes, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Lose this frame or not."""
        # A burst that has begun takes no draws until it is over.
        remaining = state or (self.frames if rng.random() < self.value else 0)
        return ([], remaining - 1) if remaining else ([Outgoing(t_us, frame)], 0)


class Bucket(NamedTuple):
    """The moving part of a rate limit: when the next frame may leave."""

    free_us: int


class RateLimit(LinkFault, frozen=True, kw_only=True):
    """Let `value` frames per second pass; what is too much is lost, or queued up to `queue_s`."""

    name: ClassVar[str] = "rate-limit"
    example: ClassVar[dict[str, Any]] = {"value": 20}

    value: Annotated[float, Meta(ge=1e-6)]
    queue_s: Seconds = 0.0

    def new_state(self, start_us: int) -> Bucket:
        """The first frame may leave at once."""
        return Bucket(start_us)

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Bucket, rng: "Generator"
    ) -> tuple[list[Outgoing], Bucket]:
        """Pass, wait or be lost."""
        due_us = max(state.free_us, t_us)
        # The queue is known by when it will be empty; nothing else needs to be kept.
        if due_us - t_us > self.queue_s * 1e6:
            return [], state
        late_s = (due_us - t_us) * 1e-6 or None
        # None: a frame that leaves at once was not touched.
        return [Outgoing(due_us, frame, late_s)], Bucket(due_us + round(1e6 / self.value))
