"""Timestamp faults: a jump, a clock drift, time that runs backwards.

They change every field with the sender's time, in any unit: `time_usec`, `usec`, `time_boot_us`,
`timestamp`, `time_boot_ms`.
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
    """Base of the timestamp faults."""

    takes_bytes: ClassVar[bool] = False
    takes_sealed: ClassVar[bool] = False

    def new_state(self, start_us: int) -> int:
        """Return the start time."""
        return start_us

    def off_s(self, t_s: float) -> float:
        """Return the timestamp error [s], `t_s` after the start of the fault."""
        raise NotImplementedError

    def apply(
        self, frame: Frame, t_us: int, state: int, rng: "Generator"
    ) -> tuple[list[Outgoing], int]:
        """Shift every timestamp of the frame; forward messages without one."""
        off_s = self.off_s((t_us - state) / 1e6)
        scales = stamp_fields(frame.layout)
        out = rewrite_fields(
            frame,
            t_us,
            # Timestamps are integers.
            {name: frame.number(name) + round(off_s * scale) for name, scale in scales.items()},
        )
        if out.frame is frame:
            return [out], state
        return [Outgoing(t_us, out.frame, abs(off_s), out.saturated)], state


def stamp_fields(layout: Layout) -> dict[str, float]:
    """Return the fields of a message with its sender's time, and their counts per second."""
    return {
        # Only fields whose unit in MAVLink's definitions is a time.
        name: COUNTS_PER_S[layout.fields[name].unit]
        for name in NAMES
        if name in layout.fields and layout.fields[name].unit in COUNTS_PER_S
    }


class TimeJump(TimestampFault, frozen=True, kw_only=True):
    """Shift timestamps by `value` seconds, forwards or backwards."""

    name: ClassVar[str] = "time-jump"
    example: ClassVar[dict[str, Any]] = {"value": 5.0}

    value: float

    def off_s(self, t_s: float) -> float:
        """Return the constant error."""
        return self.value


class TimeDrift(TimestampFault, frozen=True, kw_only=True):
    """Make the sender's clock drift by `value` seconds per second (negative: too slow)."""

    name: ClassVar[str] = "time-drift"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}

    value: float

    def off_s(self, t_s: float) -> float:
        """Return the error, which grows with time."""
        return self.value * t_s


class TimeBackwards(TimestampFault, frozen=True, kw_only=True):
    """Make timestamps run backwards by `value` seconds per second from the start of the fault."""

    name: ClassVar[str] = "time-backwards"
    example: ClassVar[dict[str, Any]] = {}

    value: Positive = 1.0

    def off_s(self, t_s: float) -> float:
        """Return the error that cancels the elapsed time and runs back at `value`."""
        return -(1.0 + self.value) * t_s
