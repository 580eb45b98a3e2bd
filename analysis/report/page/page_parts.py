"""Parts of a report page besides the plots: tables, limits, facts, reasons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class TimeButtons:
    """A table cell of buttons that zoom all plots to time windows (s) and show a plot."""

    windows: Sequence[tuple[float, float]]
    panel: str = ""


Cell = str | tuple[str, str] | TimeButtons  # text, text with a CSS class, or buttons


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table of the page; `folded` ones are closed at first."""

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


# Statistics are drawn relative to their thresholds, so their limit is 1.
SENSOR_LIMIT = {"fdi-sensor": [LimitLine(1.0, "threshold", "fail")]}


@dataclass(frozen=True, slots=True)
class ReportPage:
    """The content of a report page besides the plots.

    `limits` are keyed by panel; `tables` by the section that ends with them ("" is the overview);
    `reasons` are (verdict, text) lines that explain the verdict; `pictures` are (section, title,
    SVG).
    """

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    tables: Sequence[tuple[str, ReportTable]]
    limits: Mapping[str, Sequence[LimitLine]] = field(default_factory=dict)
    reasons: Sequence[tuple[str, str]] = ()
    pictures: Sequence[tuple[str, str, bytes]] = ()
