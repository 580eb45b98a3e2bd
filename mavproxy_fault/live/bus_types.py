"""The shape of what a proxy tells the bus besides labels and watched messages."""

from typing import Any, Required, TypedDict


class FaultState(TypedDict, total=False):
    """One fault; before the first stamp of the vehicle only `id`, `fault` and `state` are known."""

    id: Required[str]
    fault: Required[str]
    state: Required[str]  # waiting, active or done
    preset: str | None
    targets: list[str]
    start_us: int | None
    end_us: int | None
    frames: int
    magnitude: float | None
    saturated: int
    signed_skipped: int
    failures: int
    failure: str | None
    latency_us: int | None
    value: float | None
    parameters: dict[str, Any]


class ScheduleState(TypedDict):
    """Every fault, by the vehicle's clock; `revision` counts the edits."""

    t0_us: int | None
    now_us: int | None
    seed: int
    revision: int
    faults: list[FaultState]


Latencies = TypedDict(
    "Latencies",
    {"p50_us": float | None, "p99_us": float | None, "p99.9_us": float | None},
    total=False,
)


class EndpointStatistics(Latencies, total=False):
    """What one endpoint has counted since the start; latencies are of the frames it received.

    A `run` has no sockets of its own: what only those count is not there.
    """

    name: Required[str]
    direction: Required[str]
    frames_in: Required[int]
    chunks_out: Required[int]
    junk_in: Required[int]
    crc_errors: Required[int]
    unknown: Required[int]
    gaps: Required[int]
    faulted: Required[int]
    loops: Required[int]
    doubted_stamps: Required[int]
    bad_signatures: Required[int]
    peers: int
    bytes_in: int
    chunks_in: int
    bytes_out: int
    lost_in_kernel: int
    refused: int
    drops: int
    errors: int


class Recording(TypedDict):
    """Whether what passes is recorded: why not, and how many records were lost."""

    failing: str | None
    lost_records: int
