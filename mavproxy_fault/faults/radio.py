"""A telemetry radio: its rate, slots, queue and bit errors, and the RADIO_STATUS that fits them.

Each second the radio reports to the sender how full its transmit buffer is and how many frames were
lost on the air, as SiK radios do; PX4 and ArduPilot slow their streams down by `txbuf`. Sender and
buffer are those of the SiK firmware (ArduPilot/SiK, Firmware/radio/mavlink.c and serial.c).
"""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.fault import Generator, Outgoing
from mavproxy_fault.fault_parts.memory import Memory
from mavproxy_fault.fault_parts.rules import LOST, Drawn, Numbers, link_rule
from mavproxy_fault.faults.loss import Share, lose_by_length
from mavproxy_fault.faults.rate import MOST_QUEUED, QUEUE_AT, Count, RateLimit, limit_rate
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

SYSTEM, COMPONENT = ord("3"), ord("D")
STATUS_US = 1_000_000
ERRORS_AT = QUEUE_AT + 3 + 2 * MOST_QUEUED  # behind the queue: frames lost on the air
STATUS_AT = ERRORS_AT + 1  # when the next report is due
Byte = Annotated[int, Meta(ge=0, le=255)]


@link_rule
def pass_radio(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Send, queue or lose the frame, then lose it on the air if a bit is wrong."""
    late_us = limit_rate(t_us, size, p[1:], m, u, v)
    if late_us != LOST and lose_by_length(t_us, size, p, m, u, v) == LOST:
        m[ERRORS_AT] += 1.0
        return LOST
    return int(late_us)


class Radio(RateLimit, frozen=True, kw_only=True):
    """A radio of `value` bytes per second, as `rate-limit`, that reports RADIO_STATUS each second.

    `txbuf` is the free share of the queue, `rxerrors` the frames lost by `bit_error_rate`; `rssi`
    and `noise` are in the radio's units (SiK: dBm = rssi / 1.9 - 127).
    """

    name: ClassVar[str] = "radio"
    example: ClassVar[dict[str, Any]] = {"value": 3000}
    rule = staticmethod(pass_radio)

    unit: Literal["frames", "bytes"] = "bytes"
    queue_bytes: Count | None = 1850  # SiK's RX_BUFF_MAX
    bit_error_rate: Share = 0.0
    rssi: Byte = 200
    noise: Byte = 40

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit != "bytes" or not self.queue_bytes:
            raise ValueError("a radio needs `unit: bytes` and queue_bytes")

    @property
    def drawn(self) -> Drawn:
        """One for the bits of the frame."""
        return "random" if self.bit_error_rate else ""

    @property
    def remembers(self) -> int:  # type: ignore[override]
        """The queue's numbers, and those of the reports."""
        return STATUS_AT + 1

    def numbers(self) -> Numbers:
        """Return the bit-error rate, then the numbers of the queue."""
        return self.bit_error_rate, *super().numbers()

    def outcome(
        self, frame: Frame | bytes, t_us: int, memory: Memory, rng: Generator
    ) -> list[Outgoing]:
        """Return what becomes of the frame, and a report to its sender when one is due."""
        sends = super().outcome(frame, t_us, memory, rng)
        if t_us >= memory.numbers[STATUS_AT]:
            memory.numbers[STATUS_AT] = float(t_us + STATUS_US)
            sends.append(Outgoing(t_us, self._status(memory.numbers), back=True))
        return sends

    def idle_until_us(self, memory: Memory) -> int:
        """Return the time before which no report is due."""
        return int(memory.numbers[STATUS_AT])

    def _status(self, m: Any) -> Frame:
        room_us = self.numbers()[6]
        values = {
            "rxerrors": int(m[ERRORS_AT]) & 0xFFFF,
            "txbuf": round(100 * (1 - min(m[QUEUE_AT] / room_us, 1.0))),
            "rssi": self.rssi, "remrssi": self.rssi, "noise": self.noise, "remnoise": self.noise,
        }  # fmt: skip
        layout = message_layout("RADIO_STATUS")
        return Frame(build_frame(layout, values, system=SYSTEM, component=COMPONENT), layout)
