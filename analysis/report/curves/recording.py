"""The data of a flight for a report, independent of the log's format.

Times `t_s` are in seconds on one axis per report, zero at the start of the schedule or of the log.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import MEAN_EARTH_RADIUS_M
from mavproxy_fault.numerics.rotations.rotation import wrap_degrees

Vector = NDArray[np.float64]
Windows = Sequence[tuple[float, float]]  # seconds
UNGRADED = 8  # severity of messages in logs without severities


class Signal(NamedTuple):
    """One curve: `panel` is the plot it belongs to (see `panels`), `name` its legend.

    `t_s` and `value` have shape (n,); `t_s` does not decrease; NaN means "no value".
    """

    panel: str
    name: str
    t_s: Vector
    value: Vector


class Span(NamedTuple):
    """A time span on a lane of the timeline; `kind` determines its colour (see page.css).

    Kinds: mode, flag, injected, detected, warn, fail.
    """

    lane: str
    start_s: float
    end_s: float
    text: str
    kind: str


class Event(NamedTuple):
    """A message or event; `severity` is MAVLink's, 0 (worst) to 7, or UNGRADED."""

    t_s: float
    kind: str
    text: str
    severity: int = 6


class GroundTrack(NamedTuple):
    """A path in degrees and metres above mean sea level; shape (n,) each.

    Without `on_earth` its geographic position is unknown: it is drawn around 0, 0.
    """

    name: str
    t_s: Vector
    lat_deg: Vector
    lon_deg: Vector
    alt_m: Vector
    on_earth: bool = True

    def select(self, rows: NDArray[np.bool_] | slice) -> "GroundTrack":
        """The track restricted to some rows."""
        t_s, lat, lon, alt = (column[rows] for column in self[1:5])
        return GroundTrack(self.name, t_s, lat, lon, alt, self.on_earth)

    def metres_from(
        self, lat_deg: Vector | float, lon_deg: Vector | float
    ) -> tuple[Vector, Vector]:
        """Metres north and east (n,) from a place, or from one for each point, on a sphere."""
        north = np.radians(self.lat_deg - lat_deg) * MEAN_EARTH_RADIUS_M
        # Also across the antimeridian.
        east = np.radians(wrap_degrees(self.lon_deg - lon_deg)) * MEAN_EARTH_RADIUS_M
        return north, east * np.cos(np.radians(self.lat_deg))


def local_track(
    name: str, t_s: Vector, north_m: Vector, east_m: Vector, down_m: Vector
) -> GroundTrack:
    """A track (n,) in a local frame of unknown geographic position."""
    # Around the equator, where degrees of longitude and latitude are equal.
    lat, lon = (np.degrees(metres / MEAN_EARTH_RADIUS_M) for metres in (north_m, east_m))
    return GroundTrack(name, t_s, lat, lon, -down_m, on_earth=False)


class Message(NamedTuple):
    """All fields of one message as logged: `t_s` and columns, shape (n,) or (n, k)."""

    t_s: Vector
    columns: Mapping[str, NDArray[Any]]


def element_columns(
    name: str, column: NDArray[Any], most: int | None = None
) -> Iterator[tuple[str, NDArray[Any]]]:
    """A field (n,), or each of the first `most` elements of an array field (n, k), by its name."""
    if column.ndim == 1:
        yield name, column
    else:
        yield from ((f"{name}[{i}]", part) for i, part in enumerate(column.T[:most]))


class LinkQuality(NamedTuple):
    """Frames of one sender in one log, and the frames lost according to its sequence numbers."""

    log: str
    system: int
    component: int
    frames: int
    lost: int
    longest_gap_s: float


@dataclass(frozen=True, slots=True)
class FlightData:
    """The data of one flight from all its logs."""

    name: str
    autopilot: str = ""  # "px4", "ardupilot" or ""
    t0_us: int = 0
    duration_s: float = 0.0
    signals: list[Signal] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    tracks: list[GroundTrack] = field(default_factory=list)
    links: list[LinkQuality] = field(default_factory=list)
    # All (t_s, value) in the log by name, in order.
    parameters: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # for the reader: truncated data, clock jumps
    systems: tuple[int, ...] = ()  # MAVLink system ids of the vehicles
    size: int = 0  # bytes of the logs, and those outside frames
    junk_bytes: int = 0
    utc0_us: int = 0  # UTC at zero on the axis; 0 if unknown
    messages: dict[str, Message] = field(default_factory=dict)  # all of the log by name
    defaults: dict[str, float] = field(default_factory=dict)  # of parameters, if the log has them
    # Console output, processes and performance counters by title.
    printed: dict[str, str] = field(default_factory=dict)
    vehicle: str = ""  # its class (`vehicle_phase.CLASSES`), "" if unknown
    # Firmware, board, UUID and frame, as far as the log says.
    identity: dict[str, str] = field(default_factory=dict)

    def add_parameter(self, name: str, t_s: float, value: float) -> None:
        """Add a value of a parameter, if it changed: some versions log all of them repeatedly."""
        # A damaged log may hold a value that is no number.
        if not np.isfinite(value):
            return
        history = self.parameters.setdefault(name, [])
        if not history or history[-1][1] != value:
            history.append((t_s, value))

    def of(self, panel: str) -> list[Signal]:
        """The signals of one panel."""
        return [signal for signal in self.signals if signal.panel == panel]

    def curve(self, panel: str, *names: str) -> Signal | None:
        """The signal of a panel with the first of some names that it has."""
        curves = {signal.name: signal for signal in self.of(panel)}
        return next((curves[name] for name in names if name in curves), None)

    def track(self, *names: str) -> GroundTrack | None:
        """The track with the first of some names that there is."""
        tracks = {track.name: track for track in self.tracks}
        return next((tracks[name] for name in names if name in tracks), None)


def join_recordings(first: FlightData, second: FlightData) -> FlightData:
    """Merge two recordings on one axis; texts such as the name are those of the first."""
    together: dict[str, Any] = {}
    for name in (part.name for part in fields(FlightData)):
        ours, theirs = getattr(first, name), getattr(second, name)
        if isinstance(ours, (list, tuple, dict)):
            together[name] = ours | theirs if isinstance(ours, dict) else ours + theirs
    return replace(
        first,
        **together
        | {
            "events": sorted(first.events + second.events, key=lambda event: event.t_s),
            "autopilot": first.autopilot or second.autopilot,
            "vehicle": first.vehicle or second.vehicle,
            "duration_s": max(first.duration_s, second.duration_s),
            "size": first.size + second.size,
            "junk_bytes": first.junk_bytes + second.junk_bytes,
            "utc0_us": first.utc0_us or second.utc0_us,
        },
    )


def running_mean(signal: Signal, span_s: float) -> Signal:
    """A signal averaged over `span_s`; empty if it is too short."""
    count = len(signal.t_s)
    length_s = float(np.ptp(signal.t_s)) if count > 1 else 0.0
    samples = max(1, round(span_s * count / length_s)) if length_s > 0 else 1
    if count < 2 * samples:
        return signal._replace(t_s=signal.t_s[:0], value=signal.value[:0])
    smooth = np.convolve(np.nan_to_num(signal.value), np.full(samples, 1 / samples), "same")
    return signal._replace(value=smooth)


def inside_windows(t_s: Vector, windows: Windows | None) -> NDArray[np.bool_]:
    """Which times (n,) are within any of the windows (None: all)."""
    if windows is None:
        return np.ones(len(t_s), bool)
    # A log may hold thousands of flights: not window by window.
    starts, ends = np.array([(-np.inf, -np.inf), *merged_windows(windows)]).T
    inside: NDArray[np.bool_] = t_s <= ends[np.searchsorted(starts, t_s, "right") - 1]
    return inside


def merged_windows(windows: Windows) -> list[tuple[float, float]]:
    """Sorted windows; adjacent or overlapping ones are merged."""
    found: list[tuple[float, float]] = []
    for start, end in sorted(windows):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((start, end))
    return found


def true_runs(active: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and index after the last of each run of True in `active` (n,)."""
    edges = np.diff(np.concatenate(([0], active.astype(np.int8), [0])))
    return list(
        zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    )


def flag_events(spans: Sequence[Span], end_s: float) -> list[Event]:
    """Events of flags raised and cleared; a flag until `end_s`, the end of the log, is not
    cleared."""
    found = []
    for span in spans:
        if span.kind == "flag":
            found.append(Event(span.start_s, "flag", f"{span.lane} raised", 4))
            if span.end_s < end_s:
                found.append(Event(span.end_s, "flag", f"{span.lane} cleared", 5))
    return found


def value_spans(
    lane: str,
    t_s: Vector,
    values: Sequence[str] | NDArray[np.str_],
    kind: str = "mode",
    least_s: float = 0.0,
) -> list[Span]:
    """One span per run of equal, non-empty values at the times `t_s` (n,) that lasts `least_s`."""
    words = np.asarray(values)
    begins = np.flatnonzero(np.append(True, words[1:] != words[:-1])[: len(words)])
    ends = np.append(begins[1:], len(words) - 1)
    rows = zip(t_s[begins].tolist(), t_s[ends].tolist(), words[begins].tolist(), strict=True)
    return [Span(lane, begin, end, word, kind) for begin, end, word in rows
            if word and end - begin >= least_s]  # fmt: skip
