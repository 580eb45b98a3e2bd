"""Faults on the sensors' signals, over lanes, as the proxy's faults of the same names do them."""

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer
from mavproxy_fault.numerics.compile import compiled

L = rows.LANES
M, N = rows.MEASURED * L, rows.NOISE * L


@compiled
def break_signals(buf: Buffer, slot: int, first: int, last: int, t_s: float) -> None:
    """Apply one fault slot to the channels `first` to `last` - 1, which have just been measured.

    The slot's number in NOISE is its own; a sample that never came is NaN.
    """
    base = (rows.FAULTS + slot * rows.FAULT_ROWS) * L
    for channel in range(first, last):
        for lane in range(L):
            at = M + channel * L + lane
            healthy = buf[at]
            since = t_s - buf[base + rows.START * L + lane]
            mine = buf[base + lane] == channel
            active = (since >= 0.0) & (t_s < buf[base + rows.END * L + lane])
            frozen = buf[base + rows.FROZEN * L + lane]
            frozen = (
                healthy if mine & active & (frozen != frozen) else frozen
            )  # NaN before the first
            buf[base + rows.FROZEN * L + lane] = frozen
            wrong = buf[base + rows.FACTOR * L + lane] * healthy + (
                buf[base + rows.OFFSET * L + lane]
                + buf[base + rows.RATE * L + lane] * since
                + buf[base + rows.SPREAD * L + lane] * buf[N + slot * L + lane]
            )
            wrong = frozen if buf[base + rows.HOLD * L + lane] > 0.5 else wrong
            buf[at] = wrong if mine & active else healthy
