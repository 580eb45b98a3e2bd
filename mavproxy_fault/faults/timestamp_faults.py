"""Wrong time stamps: a jump, a clock that drifts, time that runs backwards.

Every field that holds the sender's time is changed, whatever its unit: `time_usec`, `usec`,
`time_boot_us`, `timestamp`, `time_boot_ms`.
"""

from typing import TYPE_CHECKING, Any, ClassVar

from mavproxy_fault.fault_parts.draft import rewrite_fields
from mavproxy_fault.fault_parts.fault import LinkFault, Outgoing
from mavproxy_fault.fault_parts.profile import Positive
from mavproxy_fault.wire.dialect import Layout
from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator

NAMES = ("time_usec", "usec", "time_boot_us", "time_unix_usec", "timestamp", "time_boot_ms")
COUNTS_PER_S = {"us": 1e6, "ms": 1e3}


class TimestampFault(LinkFault, frozen=True, kw_only=True):
    """What the three faults share: how far the stamps are off at a time."""

    takes_bytes: ClassVar[bool] = False
    takes_sealed: ClassVar[bool] = False

    def new_state(self, start_us: int) -> int:
        """When the fault began."""
        return start_us

    def off_s(self, t_s: float) -> float:
        """How far the stamps are off, `t_s` after the fault began."""
        raise NotImplementedError

    def apply(
        self, frame: Frame, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Move every stamp of the frame; a message without one passes."""
        off_s = self.off_s((t_us - state) / 1e6)
        scales = stamp_fields(frame.layout)
        out = rewrite_fields(
            frame,
            t_us,
            # Whole counts: stamps are integers.
            {name: frame.number(name) + round(off_s * scale) for name, scale in scales.items()},
        )
        if out.frame is frame:
            return [out], state
        return [Outgoing(t_us, out.frame, abs(off_s), out.saturated)], state


def stamp_fields(layout: Layout) -> dict[str, float]:
    """The fields of a message that hold its sender's time, and their counts per second."""
    return {
        # A unit that is not a time, by MAVLink's definitions, leaves the field alone.
        name: COUNTS_PER_S[layout.fields[name].unit]
        for name in NAMES
        if name in layout.fields and layout.fields[name].unit in COUNTS_PER_S
    }


class TimeJump(TimestampFault, frozen=True, kw_only=True):
    """Stamps jump by `value` seconds, forwards or backwards, and stay off."""

    name: ClassVar[str] = "time-jump"
    example: ClassVar[dict[str, Any]] = {"value": 5.0}

    value: float

    def off_s(self, t_s: float) -> float:
        """Always the same."""
        return self.value


class TimeDrift(TimestampFault, frozen=True, kw_only=True):
    """The sender's clock runs `value` seconds per second too fast (or, negative, too slow)."""

    name: ClassVar[str] = "time-drift"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}

    value: float

    def off_s(self, t_s: float) -> float:
        """Grows with time."""
        return self.value * t_s


class TimeBackwards(TimestampFault, frozen=True, kw_only=True):
    """Stamps run backwards, `value` seconds per second, from where the fault found them."""

    name: ClassVar[str] = "time-backwards"
    example: ClassVar[dict[str, Any]] = {}

    value: Positive = 1.0

    def off_s(self, t_s: float) -> float:
        """Undo the time that passed, and as much again."""
        # Once to stand still, and `value` times to run back.
        return -(1.0 + self.value) * t_s
