"""Statistics of a running proxy: latency percentiles and a table per endpoint."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mavproxy_fault.proxy.delay_queue import LOST, MOST
from mavproxy_fault.wire.dialect import describe_unknown

if TYPE_CHECKING:
    from mavproxy_fault.proxy.core import Core

PERCENTILES = (50, 99, 99.9)
COLUMNS = (
    ("endpoint", "name"), ("peers", "peers"), ("in", "frames_in"), ("bytes in", "bytes_in"),
    ("out", "chunks_out"), ("bytes out", "bytes_out"), ("junk", "junk_in"),
    ("crc", "crc_errors"), ("gaps", "gaps"), ("lost", "lost_in_kernel"),
    ("faulted", "faulted"), ("drops", "drops"), ("errors", "errors"),
    ("p50 us", "p50_us"), ("p99 us", "p99_us"), ("p99.9", "p99.9_us"),
)  # fmt: skip


class LatencyHistogram:
    """A histogram of eight bins per octave, so that percentiles are accurate to 9 %."""

    def __init__(self) -> None:
        self._counts: dict[int, int] = {}

    def add(self, ns: int, count: int = 1) -> None:
        """Add `count` frames that took `ns` nanoseconds."""
        octave = max(ns, 16).bit_length()
        self.add_step(octave << 3 | max(ns, 16) >> (octave - 4) & 7, count)

    def add_step(self, step: int, count: int) -> None:
        """Add `count` frames to a bin."""
        self._counts[step] = self._counts.get(step, 0) + count

    def percentile_us(self, percent: float) -> float | None:
        """Return a percentile of the latency in microseconds; None without frames."""
        total = sum(self._counts.values())
        passed = 0
        for step, count in sorted(self._counts.items()):
            passed += count
            if passed >= total * percent / 100:
                return round((8 + (step & 7) + 1) * 2.0 ** ((step >> 3) - 4) * 1e-3, 1)
        return None

    def summary(self) -> dict[str, float | None]:
        """Return the percentiles by name."""
        return {f"p{percent}_us": self.percentile_us(percent) for percent in PERCENTILES}


def link_statistics(core: "Core", number: int) -> dict[str, Any]:
    """Return the core's counts for one link."""
    role, state, parsed = core.links[number], core.states[number], core.parsed[number]
    return {
        "name": role.name,
        "direction": role.direction,
        "frames_in": state.frames,
        "junk_in": state.junk,
        "crc_errors": parsed.crc_errors,
        "unknown": parsed.unknown,
        "unknown_ids": {str(number): count for number, count in parsed.unknown_ids.items()},
        "gaps": state.gaps,
        "faulted": state.faulted,
        "delays_lost": core.waiting.numbers[LOST + number],
        "loops": state.loops,
        "doubted_stamps": state.unconfirmed,
        "bad_signatures": state.bad_signatures,
    }


def format_endpoints(endpoints: Sequence[dict[str, Any]]) -> str:
    """Format the endpoints' statistics as an aligned table, and name unknown messages."""
    rows = [[title for title, _ in COLUMNS]]
    rows += [
        ["-" if point.get(key) is None else str(point[key]) for _, key in COLUMNS]
        for point in endpoints
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    lines = [
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    unknown = [(point["name"], point.get("unknown_ids")) for point in endpoints]
    return "\n".join(
        lines
        + [
            f"{name}: {describe_unknown({int(number): count for number, count in ids.items()})}"
            for name, ids in unknown
            if ids
        ]
        + [
            f"{point['name']}: {lost} delayed frames lost, as {MOST} were waiting"
            for point in endpoints
            if (lost := point.get("delays_lost"))
        ]
    )
