"""What stands on a page besides the recording's own plots: tables, limits, facts, reasons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class TimeButtons:
    """A cell of buttons that zoom all plots: stretches of time (s), and the plot to show."""

    windows: Sequence[tuple[float, float]]
    panel: str = ""


Cell = str | tuple[str, str] | TimeButtons  # text, text with a CSS class, or buttons


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table: head and rows."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    folded: bool = False
    style: str = ""


@dataclass(frozen=True, slots=True)
class LimitLine:
    """A horizontal line on a plot."""

    value: float
    text: str
    kind: str


# The statistics are drawn over their thresholds, so that the limit of each is 1.
SENSOR_LIMIT = {"fdi-sensor": [LimitLine(1.0, "threshold", "fail")]}


@dataclass(frozen=True, slots=True)
class ReportPage:
    """What stands on the page besides the recording's own plots.

    `limits` are keyed by panel; `tables` by the section they stand at the end of ("" is the
    overview); `reasons` say in a line each what the verdict rests on: (kind, text); `pictures` are
    (section, title, SVG).
    """

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    tables: Sequence[tuple[str, ReportTable]]
    limits: Mapping[str, Sequence[LimitLine]] = field(default_factory=dict)
    reasons: Sequence[tuple[str, str]] = ()
    pictures: Sequence[tuple[str, str, bytes]] = ()
