"""What a report is made of, whatever file it came from: signals, spans, events, tracks.

Times are seconds on one axis per report (`t_s`), zero at the start of the schedule or of the log.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
UNGRADED = 8  # severity of a text in a log that gives none


@dataclass(frozen=True, slots=True)
class Signal:
    """One curve: `panel` is the plot it belongs to (see `panels`), `name` its legend.

    `t_s` and `value` have shape (n,); `t_s` does not decrease; NaN stands for "no value".
    """

    panel: str
    name: str
    t_s: Vector
    value: Vector


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time on a lane of the timeline; `kind` is its colour (see page.css).

    Kinds: mode, flag, injected, detected, warn, fail.
    """

    lane: str
    start_s: float
    end_s: float
    text: str
    kind: str


@dataclass(frozen=True, slots=True)
class Event:
    """What was said or done at an instant; `severity` is MAVLink's, 0 (worst) to 7, or UNGRADED."""

    t_s: float
    kind: str
    text: str
    severity: int = 6


@dataclass(frozen=True, slots=True)
class Track:
    """A path over ground; degrees, and metres above mean sea level; shape (n,) each."""

    name: str
    t_s: Vector
    lat_deg: Vector
    lon_deg: Vector
    alt_m: Vector


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """Frames of one sender in one log, and how many its sequence numbers say are missing."""

    log: str
    system: int
    component: int
    frames: int
    lost: int
    longest_gap_s: float


@dataclass(frozen=True, slots=True)
class Recording:
    """All that one flight's logs hold.

    Attributes
    ----------
    autopilot : str
        "px4", "ardupilot" or "".
    parameters : dict
        By name every (t_s, value) the log holds, in order.
    notes : list of str
        What a reader must know: cut data, clocks that jump.
    systems : tuple of int
        MAVLink system ids of the vehicles.
    size, junk_bytes : int
        Bytes of the logs, and those of them that belong to no frame.
    """

    name: str
    autopilot: str = ""
    t0_us: int = 0
    duration_s: float = 0.0
    signals: list[Signal] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    tracks: list[Track] = field(default_factory=list)
    links: list[LinkQuality] = field(default_factory=list)
    parameters: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    systems: tuple[int, ...] = ()
    size: int = 0
    junk_bytes: int = 0

    def of(self, panel: str) -> list[Signal]:
        """The signals of one panel."""
        return [signal for signal in self.signals if signal.panel == panel]


def joined(first: Recording, second: Recording) -> Recording:
    """Two recordings on one axis as one."""
    return Recording(
        first.name,
        first.autopilot or second.autopilot,
        first.t0_us,
        max(first.duration_s, second.duration_s),
        first.signals + second.signals,
        first.spans + second.spans,
        sorted(first.events + second.events, key=lambda event: event.t_s),
        first.tracks + second.tracks,
        first.links + second.links,
        first.parameters | second.parameters,
        first.notes + second.notes,
        first.systems + second.systems,
        first.size + second.size,
        first.junk_bytes + second.junk_bytes,
    )


def runs(active: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and index after the last of each stretch of True; shape (n,) in."""
    edges = np.diff(np.concatenate(([0], active.astype(np.int8), [0])))
    return list(
        zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    )
