"""The rate of a link: transmission times, a queue, bursts, and the slots of a shared channel.

One rule: a frame waits until the line is free, occupies it for its transmission time, and is lost
if the queue is full. In bytes that is netem's `rate`, with `burst_bytes` the token bucket of the
kernel's tbf, with `peak` its second bucket (linux/net/sched/sch_netem.c, sch_tbf.c).
"""

import math
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.profile import Duration, Seconds
from mavproxy_fault.fault_parts.rules import LOST, Numbers, ProfiledLinkFault, link_rule

MOST_QUEUED = 1000  # frames in a queue of bytes, as in netem's by default
QUEUE_AT = 3  # of its numbers in memory
BYTES_QUEUE_S = 1.0  # chosen: what a byte queue without a given size can take
Count = Annotated[int, Meta(ge=0)]


@link_rule
def limit_rate(t_us: float, size: int, p: Numbers, m: Any, u: float, v: float) -> int:
    """Send, queue or lose the frame.

    All in time of open slots, from the start of the fault (`m[0]`) on: that of the frame, and
    those from which the line is free but for a burst (`m[1]`), and so at its peak rate (`m[2]`).
    """
    per_frame_us, per_byte_us, overhead, sent_when_through = p[0], p[1], p[2], p[3]
    longest_us, room_us, burst_us, period_us, slot_us = (
        p[4], p[5], p[6], p[7], p[8],
    )  # fmt: skip
    least, cell, cell_overhead, peak_us, peak_burst_us = p[9], p[10], p[11], p[12], p[13]
    length = max(size + overhead, least)
    if cell:
        length = math.ceil(length / cell) * (cell + cell_overhead)
    cost_us, peak_cost_us = per_frame_us + per_byte_us * length, peak_us * length
    periods = math.floor((t_us - m[0]) / period_us)
    open_us = periods * slot_us + min(t_us - m[0] - periods * period_us, slot_us)
    free_us = max(m[1], open_us) - burst_us
    leaves_us = max(free_us + cost_us * sent_when_through, open_us)
    if peak_us:
        leaves_us = max(leaves_us, max(m[2], open_us) + peak_cost_us - peak_burst_us)
    if leaves_us - open_us > longest_us:
        return LOST
    if room_us >= 0.0 and not takes_place(
        open_us, leaves_us, cost_us, room_us, p[14], m[QUEUE_AT:]
    ):
        return LOST
    m[1] = free_us + cost_us + burst_us
    if peak_us:  # a bucket that is full while the other one delays the frame fills no further
        m[1] = max(m[1], leaves_us + min(burst_us, cost_us))
        m[2] = max(m[2] + peak_cost_us, leaves_us + min(peak_burst_us, peak_cost_us))
    periods = math.floor(leaves_us / slot_us)
    return max(int(m[0] + periods * period_us + leaves_us - periods * slot_us - t_us), 0)


def takes_place(
    now_us: float, leaves_us: float, cost_us: float, room_us: float, most: float, m: Any
) -> bool:
    """Whether a queue of limited size takes a frame; one that is being sent still waits as a whole.

    Sizes are transmission times: `m[0]` is the sum of those waiting, then follow the numbers of
    frames that came and that left, and a ring of when each leaves and its size.
    """
    ring = 3
    while m[2] < m[1]:
        slot = ring + 2 * (int(m[2]) % MOST_QUEUED)
        if m[slot] > now_us:
            break
        m[0] -= m[slot + 1]
        m[2] += 1.0
    if m[0] + cost_us > room_us or m[1] - m[2] >= most:
        return False
    if leaves_us > now_us:
        slot = ring + 2 * (int(m[1]) % MOST_QUEUED)
        m[slot], m[slot + 1] = leaves_us, cost_us
        m[0] += cost_us
        m[1] += 1.0
    return True


class RateLimit(ProfiledLinkFault, frozen=True, kw_only=True):
    """Limit the rate to `value` frames per second, or bytes per second with `unit: bytes`.

    Frames wait up to `queue_s`, or until `queue_bytes` or `queue_frames` wait (bytes without
    either: 1 s), then they are lost. In bytes a frame arrives when its last byte has left, at the
    earliest; `overhead_bytes` are added to each (negative: headers compressed), it takes at least
    `least_bytes`, or whole cells of `cell_bytes` and an overhead each. `burst_bytes` may leave at
    once after a pause, at most at `peak` bytes per second but for `peak_burst_bytes`. With
    `period_s` and `slot_s` the line is open for a slot at the beginning of each period, as in TDMA.
    """

    name: ClassVar[str] = "rate-limit"
    example: ClassVar[dict[str, Any]] = {"value": 20}
    rule = staticmethod(limit_rate)
    certain: ClassVar[bool] = True

    value: Annotated[float, Meta(ge=1e-6)] | None = None
    unit: Literal["frames", "bytes"] = "frames"
    overhead_bytes: int = 0
    least_bytes: Count = 1
    cell_bytes: Count = 0
    cell_overhead_bytes: Count = 0
    queue_s: Seconds | None = None
    queue_bytes: Count | None = None
    queue_frames: Annotated[int, Meta(ge=1, le=MOST_QUEUED)] | None = None
    burst_bytes: Count = 0
    peak: Annotated[float, Meta(ge=1e-6)] | None = None
    peak_burst_bytes: Count = 0
    period_s: Duration | None = None
    slot_s: Duration | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.overhead_bytes, self.queue_bytes, self.burst_bytes, self.cell_bytes, self.peak
        if self.unit == "frames" and (any(given) or self.least_bytes > 1):
            raise ValueError("overhead, cells, queue, burst and peak in bytes need `unit: bytes`")
        if self.queue_s is not None and self._counts:
            raise ValueError("takes either queue_s, or queue_bytes or queue_frames")
        if (self.period_s is None) != (self.slot_s is None):
            raise ValueError("slots need both period_s and slot_s")
        if self.period_s is not None and self.slot_s is not None and self.slot_s > self.period_s:
            raise ValueError("slot_s is longer than period_s; give a shorter slot")

    @property
    def _counts(self) -> bool:
        """Whether the queue has a size, instead of a time."""
        return self.queue_bytes is not None or self.queue_frames is not None

    @property
    def remembers(self) -> int:  # type: ignore[override]
        """Start, when the line is free, and the queue with a size, if there is one."""
        return QUEUE_AT + 3 + 2 * MOST_QUEUED if self._counts else QUEUE_AT

    def numbers(self) -> Numbers:
        """Return what a frame costs and when it is lost, in microseconds."""
        unit_us, in_bytes = 1e6 / max(self.value or 0.0, 1e-6), self.unit == "bytes"
        queue_s = self.queue_s if self.queue_s is not None else BYTES_QUEUE_S if in_bytes else 0.0
        longest_us, room_us = queue_s * 1e6, -1.0
        if self._counts:
            queue_bytes = math.inf if self.queue_bytes is None else self.queue_bytes
            longest_us, room_us = math.inf, queue_bytes * unit_us
        period_us = (self.period_s or 1.0) * 1e6
        slot_us = (self.slot_s or 1.0) * 1e6
        if in_bytes:
            cost = 0.0, unit_us, float(self.overhead_bytes), 1.0
        else:
            cost = float(round(unit_us)), 0.0, 0.0, 0.0
        peak_us = 1e6 / self.peak if self.peak else 0.0
        return (
            *cost, longest_us, room_us, self.burst_bytes * unit_us, period_us, slot_us,
            self.least_bytes, self.cell_bytes, self.cell_overhead_bytes,
            peak_us, self.peak_burst_bytes * peak_us, self.queue_frames or MOST_QUEUED,
        )  # fmt: skip
