"""Render the body of a report page: overview, sections with plot containers, tables.

Texts of a log are untrusted and always escaped.
"""

import base64
from collections.abc import Sequence
from html import escape
from importlib.resources import files

from analysis.report.curves.panels import (
    BY_KEY,
    CHECKS,
    FIELDS,
    PANELS,
    SPECTRA,
    SYSTEM,
    TIMELINE,
)
from analysis.report.curves.recording import FlightData
from analysis.report.page.page_model import Model
from analysis.report.page.page_parts import Cell, ReportPage, ReportTable, TimeButtons

VERDICTS = ("PASS", "WARN", "FAIL")
MAP = "Map"
# Open on narrow screens too, as the most important sections.
OPEN_WHEN_NARROW = (TIMELINE, CHECKS)
EVENTS_SHOWN = 400
# What sections begin with.
BEGINNINGS = {
    TIMELINE: "timeline.html", FIELDS: "fields.html", MAP: "map.html", SPECTRA: "spectra.html",
}  # fmt: skip
NEAR_S = 5.0  # shown before and after a clicked event


def read_asset(name: str) -> str:
    """The text of a file in `assets`."""
    return (files("analysis.report.page") / "assets" / name).read_text(encoding="utf-8")


def read_markup(name: str) -> str:
    """The HTML of a file in `assets`; its lines are joined."""
    return read_asset(name).replace("\n", "")


def section_anchor(name: str) -> str:
    """The HTML id of a section."""
    # Letters and digits only, as it is part of addresses.
    return "to-" + "".join(c if c.isalnum() else "-" for c in name.lower())


def css_class(word: str) -> str:
    """The CSS class of a verdict."""
    # Untrusted text never becomes a class.
    return word if word in VERDICTS else "NONE"


def sections_of(page: ReportPage, recording: FlightData, model: Model, fields: bool) -> list[str]:
    """The sections with content, in order."""
    with_plots = {BY_KEY[str(panel["key"])].section for panel in model["panels"]}
    # The empty name is the overview, which is not a foldable section.
    with_tables = {section for section, _ in page.tables if section}
    with_pictures = {section for section, _, _ in page.pictures}
    # Each section once, in the order of the panels.
    every = dict.fromkeys(panel.section for panel in PANELS)
    shown = with_plots | with_tables | with_pictures | ({SYSTEM} if recording.printed else set())
    sections = [name for name in every if name in shown]
    first = []
    if recording.spans or recording.events or TIMELINE in with_tables:
        first.append(TIMELINE)
    if CHECKS in with_tables:
        first.append(CHECKS)
    if fields:
        first.append(FIELDS)
    if recording.tracks:
        first.append(MAP)
    last = [SPECTRA] if model["spectra"] else []
    sections = first + [name for name in sections if name not in first] + last
    # Sections that only have tables come last, by name.
    return sections + sorted(with_tables - set(sections))


def overview_html(page: ReportPage, recording: FlightData) -> str:
    """The verdict's reasons, facts and notes."""
    facts = "".join(
        f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>"
        for name, value in page.facts
    )
    reasons = "".join(
        f'<li><b class="{css_class(kind)}">{escape(kind)}</b> {escape(text)}</li>'
        for kind, text in page.reasons
    )
    reasons = f'<ul class="reasons">{reasons}</ul>' if reasons else ""
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in recording.notes)
    tables = "".join(_table(table) for section, table in page.tables if section == "")
    return (
        f'<section id="to-overview">{reasons}<div class="facts">{facts}</div>{notes}{tables}'
        "</section>"
    )


def section_html(section: str, page: ReportPage, recording: FlightData, model: Model) -> str:
    """One foldable section."""
    begins = section in BEGINNINGS and (section != TIMELINE or bool(recording.spans))
    parts = [read_markup(BEGINNINGS[section])] if begins else []
    plots = [
        _plot(panel["key"], panel["title"])
        for panel in model["panels"]
        if BY_KEY[panel["key"]].section == section
    ]
    if section == SPECTRA:
        plots = [_plot(panel["key"], panel["title"]) for panel in model["spectra"]]
        plots += [
            _plot(f"{panel['key']}-{image['axis']}", f"{panel['title']}, {image['title']}")
            for panel in model["spectra"]
            for image in panel["images"]
        ]
    plots += [_picture(title, svg) for place, title, svg in page.pictures if place == section]
    if plots:
        parts.append(f'<div class="plots">{"".join(plots)}</div>')
    parts.extend(_table(table) for name, table in page.tables if name == section)
    if section == TIMELINE:
        parts.append(_events(recording))
    if section == SYSTEM:
        parts.extend(_printed(title, text) for title, text in recording.printed.items())
    # The attribute keeps it open on narrow screens.
    narrow = " data-narrow" if section in OPEN_WHEN_NARROW else ""
    return (
        f'<details class="section" id="{section_anchor(section)}" open{narrow}><summary>'
        f"<h2>{escape(section)}</h2></summary>{''.join(parts)}</details>"
    )


def _plot(key: str, title: str) -> str:
    return (
        f'<div class="plot"><h3>{escape(title)}</h3><div class="area" id="plot-{key}"></div></div>'
    )


def _picture(title: str, svg: bytes) -> str:
    """As a separate image, since the page's policy forbids inline styles."""
    data = base64.b64encode(svg).decode("ascii")
    image = f'<img alt="{escape(title)}" src="data:image/svg+xml;base64,{data}">'
    return f'<div class="plot"><h3>{escape(title)}</h3>{image}</div>'


def _events(recording: FlightData) -> str:
    rows: list[Sequence[Cell]] = [
        (
            TimeButtons([(event.t_s - NEAR_S, event.t_s + NEAR_S)]),
            event.kind,
            # MAVLink severities: 0 emergency, 1 alert, 2 critical.
            (event.text, "FAIL" if event.severity <= 2 else ""),
        )
        for event in recording.events[:EVENTS_SHOWN]
    ]
    if not rows:
        return ""
    missing = len(recording.events) - len(rows)
    note = f"{missing} more; up to 200 of one text are in the JSON file." if missing else ""
    title = f"Events and messages ({len(recording.events)})"
    return _table(ReportTable(title, ("time", "kind", "text"), rows, note, folded=len(rows) > 12))


def _printed(title: str, text: str) -> str:
    return (
        f"<details><summary>{escape(title)}</summary>"
        f'<pre class="wide" tabindex="0">{escape(text)}</pre></details>'
    )


def table_html(table: ReportTable) -> str:
    """A table without its title and note; it scrolls if it is too wide."""
    head = "".join(f"<th>{escape(name)}</th>" for name in table.head)
    heads = table.head if table.style == "cards" else [""] * len(table.head)
    rows = "".join("<tr>" + "".join(map(_cell, row, heads)) + "</tr>" for row in table.rows)
    return (
        f'<div class="wide" tabindex="0" role="group" aria-label="{escape(table.title)}">'
        f'<table class="{table.style}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )


def _table(table: ReportTable) -> str:
    text = table_html(table)
    if table.note:
        text += f'<p class="note">{escape(table.note)}</p>'
    if table.folded:
        return f"<details><summary>{escape(table.title)}</summary>{text}</details>"
    return f"<h3>{escape(table.title)}</h3>{text}"


def _cell(cell: Cell, head: str) -> str:
    label = f' data-label="{escape(head)}"' if head else ""
    if isinstance(cell, TimeButtons):
        return f"<td{label}>{_buttons(cell)}</td>"
    text, style = cell if isinstance(cell, tuple) else (cell, "")
    # At most a sign and a point: CSS right-aligns numbers.
    number = text.replace(".", "", 1).replace("-", "", 1).isdigit()
    styles = " ".join(filter(None, (style, "number" if number else "")))
    classes = f' class="{styles}"' if styles else ""
    return f"<td{label}{classes}>{escape(text)}</td>"


def _buttons(cell: TimeButtons) -> str:
    """Up to three time windows as buttons; the scripts reformat their times."""
    shown = " ".join(
        f'<button class="moment" data-from="{start:.3f}" data-to="{end:.3f}" '
        f'data-panel="{escape(cell.panel)}">{start:.1f}–{end:.1f} s</button>'
        for start, end in cell.windows[:3]
    )
    return shown + (f" and {len(cell.windows) - 3} more" if len(cell.windows) > 3 else "")
