"""Timing faults of frames: delay, jitter, reordering, duplication."""

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import LinkFault, Outgoing
from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.faults.loss import Share
from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator


class Delay(LinkFault, frozen=True, kw_only=True):
    """Delay every frame by `value` seconds."""

    name: ClassVar[str] = "delay"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}

    value: Seconds

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Delay the frame."""
        return [delay_frame(frame, t_us, self.value)], None


class Jitter(LinkFault, frozen=True, kw_only=True):
    """Delay frames by `base_s` plus a random time.

    `value` is the largest delay (uniform), the mean (exponential), the sigma (normal, clipped at
    zero), or the scale (Pareto of `shape`, heavy-tailed). With `keep_order` no frame overtakes
    another.
    """

    name: ClassVar[str] = "jitter"
    example: ClassVar[dict[str, Any]] = {"value": 0.02}

    value: Seconds
    distribution: Literal["uniform", "normal", "exponential", "pareto"] = "uniform"
    base_s: Seconds = 0.0
    shape: Annotated[float, Meta(gt=1)] = 3.0
    keep_order: bool = True

    def new_state(self, start_us: int) -> int:
        """Return the due time of the previous frame."""
        return start_us

    def apply(
        self, frame: Frame | bytes, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Delay the frame by a random time."""
        out = delay_frame(frame, t_us, self.base_s + self._draw(rng))
        # It would overtake the previous frame, so it waits for that one.
        if self.keep_order and out.due_us < state:
            # Frames with equal due times are sent in order of arrival.
            out = delay_frame(frame, t_us, (state - t_us) * 1e-6)
        return [out], max(out.due_us, state)

    def _draw(self, rng: "Generator") -> float:
        if self.distribution == "uniform":
            return float(rng.uniform(0.0, self.value))
        # Clipped at zero: a frame cannot be sent before it arrives.
        if self.distribution == "normal":
            return max(float(rng.normal(0.0, self.value)), 0.0)
        if self.distribution == "exponential":
            return float(rng.exponential(self.value))
        return self.value * float(rng.pareto(self.shape))


class Reorder(LinkFault, frozen=True, kw_only=True):
    """Delay a fraction `value` of the frames by `by_s`, so that later ones overtake them."""

    name: ClassVar[str] = "reorder"
    example: ClassVar[dict[str, Any]] = {"value": 0.2, "by_s": 0.02}

    value: Share = 0.1
    by_s: Seconds = 0.05

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """Delay the frame at random."""
        return [delay_frame(frame, t_us, self.by_s if rng.random() < self.value else 0.0)], None


class Duplicate(LinkFault, frozen=True, kw_only=True):
    """Repeat a fraction `value` of the frames: `copies` more, the last `by_s` later."""

    name: ClassVar[str] = "duplicate"
    example: ClassVar[dict[str, Any]] = {"copies": 2, "by_s": 0.01}

    value: Share = 1.0
    copies: Annotated[int, Meta(ge=1, le=100)] = 1
    by_s: Seconds = 0.0

    def apply(
        self,
        frame: Frame | bytes,
        t_us: int,
        state: Any,
        rng: "Generator",
    ) -> tuple[list[Outgoing], Any]:
        """Send the frame, and its copies at random."""
        first = Outgoing(t_us, frame)
        if self.value < 1.0 and rng.random() >= self.value:
            return [first], None
        # The copies are spread evenly up to `by_s`.
        step_s = self.by_s / self.copies
        return [
            first,
            *(delay_frame(frame, t_us, step_s * (i + 1)) for i in range(self.copies)),
        ], None


def delay_frame(frame: Frame | bytes, t_us: int, by_s: float) -> Outgoing:
    """Return a frame delayed by `by_s` seconds."""
    by_us = round(by_s * 1e6)
    # The magnitude of the label is the delay; a frame without delay is unchanged.
    return Outgoing(t_us + by_us, frame, by_us * 1e-6 if by_us else None)
