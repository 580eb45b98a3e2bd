"""Timestamp faults: a jump, a clock drift, time that runs backwards.

They change every field with the sender's time, in any unit: `time_usec`, `usec`, `time_boot_us`,
`timestamp`, `time_boot_ms`.
"""

from typing import Any, ClassVar, Literal

from mavproxy_fault.documents.document_check import Positive
from mavproxy_fault.fault_parts.elements import locate_element, read_elements, write_elements
from mavproxy_fault.fault_parts.fault import Generator, LinkFault, Outgoing
from mavproxy_fault.fault_parts.rules import Numbers, value_rule
from mavproxy_fault.wire.dialect import Layout
from mavproxy_fault.wire.frame import Frame

NAMES = ("time_usec", "usec", "time_boot_us", "time_unix_usec", "timestamp", "time_boot_ms")
COUNTS_PER_S = {"us": 1e6, "ms": 1e3}


@value_rule
def shift_stamp(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Shift by an error that grows with time, in counts; timestamps are integers."""
    return x[i] + round((p[0] + p[1] * t_s) * p[2])


class TimestampFault(LinkFault, frozen=True, kw_only=True):
    """Base of the timestamp faults, whose rule acts on every timestamp of a frame."""

    clock: ClassVar[Literal["vehicle", "link"]] = "vehicle"  # which is what it changes
    takes_bytes: ClassVar[bool] = False
    takes_sealed: ClassVar[bool] = False
    rule = staticmethod(shift_stamp)

    def new_state(self, start_us: int) -> int:
        """Return the start time."""
        return start_us

    def error(self) -> tuple[float, float]:
        """Return the timestamp error [s] at the start of the fault, and its rate [s/s]."""
        raise NotImplementedError

    def apply(
        self, frame: Frame, t_us: int, state: int, rng: Generator
    ) -> tuple[list[Outgoing], int]:
        """Shift every timestamp of the frame; forward messages without one."""
        fields, t_s = stamp_fields(frame.layout), (t_us - state) / 1e6
        elements, scales = [locate_element(frame.layout, name) for name in fields], fields.values()
        before = read_elements(frame, elements)
        after = [
            shift_stamp(before, i, t_s, (*self.error(), scale), (), 0.0)
            for i, scale in enumerate(scales)
        ]
        return [write_elements(frame, t_us, elements, after, list(scales))], state


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

    def error(self) -> tuple[float, float]:
        """Return the constant error."""
        return self.value, 0.0


class TimeDrift(TimestampFault, frozen=True, kw_only=True):
    """Make the sender's clock drift by `value` seconds per second (negative: too slow)."""

    name: ClassVar[str] = "time-drift"
    example: ClassVar[dict[str, Any]] = {"value": 0.5}

    value: float

    def error(self) -> tuple[float, float]:
        """Return the error, which grows with time."""
        return 0.0, self.value


class TimeBackwards(TimestampFault, frozen=True, kw_only=True):
    """Make timestamps run backwards by `value` seconds per second from the start of the fault."""

    name: ClassVar[str] = "time-backwards"
    example: ClassVar[dict[str, Any]] = {}

    value: Positive = 1.0

    def error(self) -> tuple[float, float]:
        """Return the error that cancels the elapsed time and runs back at `value`."""
        return 0.0, -(1.0 + self.value)
