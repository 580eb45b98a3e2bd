"""Types of the state and statistics that a proxy publishes on Zenoh."""

from typing import Any, Required, TypedDict


class FaultState(TypedDict, total=False):
    """State of one fault; before the vehicle's first timestamp only the required keys exist."""

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
    """State of all faults on the vehicle's clock; `revision` counts the edits."""

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
    """Counters of one endpoint since the start; the latencies are those of its received frames.

    The optional counters belong to sockets and are absent under `run`, which has none.
    """

    name: Required[str]
    direction: Required[str]
    frames_in: Required[int]
    chunks_out: Required[int]
    junk_in: Required[int]
    crc_errors: Required[int]
    unknown: Required[int]
    unknown_ids: Required[dict[str, int]]
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
    delays_lost: int
    refused: int
    drops: int
    errors: int


class Recording(TypedDict):
    """State of the recording: why it fails (None if it works) and how many records were lost."""

    failing: str | None
    lost_records: int
