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
    "Latencies", {"p50_us": float | None, "p99_us": float | None, "p99.9_us": float | None}
)


class EndpointStatistics(Latencies):
    """What one endpoint has counted since the start; latencies are of the frames it received."""

    name: str
    direction: str
    peers: int
    frames_in: int
    bytes_in: int
    chunks_in: int
    bytes_out: int
    chunks_out: int
    junk_in: int
    crc_errors: int
    unknown: int
    gaps: int
    lost_in_kernel: int
    faulted: int
    loops: int
    doubted_stamps: int
    bad_signatures: int
    refused: int
    drops: int
    errors: int


class Recording(TypedDict):
    """Whether what passes is recorded: why not, and how many records were lost."""

    failing: str | None
    lost_records: int
