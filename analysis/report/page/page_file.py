"""A report's one HTML file: tables written out, plots as a model with packed numbers.

The file needs no network: uPlot (MIT, see `assets/uPlot.LICENSE`), the style and the scripts stand
in it. What a log says is text from outside: it is escaped wherever it stands.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from analysis.report.judging.checks import armed_windows
from analysis.report.page.pack import Block, broken, thinned, unwrapped
from analysis.report.page.panels import BY_KEY, CHECKS, PANELS, TIMELINE
from analysis.report.recordings.recording import Recording, Track, Vector

EARTH_RADIUS_M = 6_371_000.0  # for a picture of the track; nothing is measured on it
VERDICT_CLASS = {"PASS": "PASS", "WARN": "WARN", "FAIL": "FAIL"}
EVENTS_SHOWN = 400
HEADINGS = {"yaw", "error-yaw"}
MARGIN_S = 2.0  # of a track, before arming and after


@dataclass(frozen=True, slots=True)
class Table:
    """A table: head and rows; a cell is text, or (text, CSS class)."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str | tuple[str, str]]]
    note: str = ""
    folded: bool = False
    style: str = ""


@dataclass(frozen=True, slots=True)
class Limit:
    """A horizontal line on a plot."""

    value: float
    text: str
    kind: str


SENSOR_LIMIT = {"fdi-sensor": [Limit(1.0, "threshold", "fail")]}


@dataclass(frozen=True, slots=True)
class Page:
    """What stands on the page besides the recording's own plots.

    `limits` are keyed by panel; `tables` by the section they stand at the end of ("" is the
    overview); `reasons` say in a line each what the verdict rests on: (kind, text).
    """

    title: str
    verdict: str
    facts: Sequence[tuple[str, str]]
    tables: Sequence[tuple[str, Table]]
    limits: Mapping[str, Sequence[Limit]] = field(default_factory=dict)
    reasons: Sequence[tuple[str, str]] = ()


def html(page: Page, recording: Recording) -> str:
    """The whole file."""
    block = Block()
    model, sections = _model(page, recording, block)
    names = ["Overview", *sections]
    body = [_overview(page, recording)]
    for section in sections:
        body.append(f'<h2 id="{_anchor(section)}">{escape(section)}</h2>')
        body.extend(_section(section, page, recording, model))
    links = "".join(f'<a href="#{_anchor(name)}">{escape(name)}</a>' for name in names)
    model_text = json.dumps(model, allow_nan=False).replace("<", "\\u003c")
    return "".join(
        (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(page.title)}</title>",
            f"<style>{_asset('uPlot.min.css')}{_asset('page.css')}</style></head><body>",
            f"<header><h1>{escape(page.title)}</h1>",
            f'<p class="verdict {_css(page.verdict)}">{escape(page.verdict)}</p></header>',
            f'<nav><div>{links}<button id="reset">whole flight</button></div></nav><main>',
            *body,
            f'</main><script type="application/json" id="model">{model_text}</script>',
            f'<script type="text/plain" id="numbers">{block.text()}</script>',
            f"<!-- uPlot: {_asset('uPlot.LICENSE')} -->",
            *(
                f"<script>{_asset(name)}</script>"
                for name in ("uPlot.iife.min.js", "plots.js", "tracks.js", "page.js")
            ),
            "</body></html>\n",
        )
    )


def _asset(name: str) -> str:
    return (files("analysis.report.page") / "assets" / name).read_text(encoding="utf-8")


def _anchor(name: str) -> str:
    return "to-" + "".join(c if c.isalnum() else "-" for c in name.lower())


def _css(word: str) -> str:
    return VERDICT_CLASS.get(word, "NONE")


def _model(page: Page, recording: Recording, block: Block) -> tuple[dict[str, Any], list[str]]:
    """What the scripts draw from, and the sections that have something to show, in order."""
    panels = []
    for panel in PANELS:
        series = []
        for signal in recording.of(panel.key):
            t_s, value = thinned(*broken(signal.t_s, signal.value))
            if panel.key in HEADINGS:
                t_s, value = unwrapped(t_s, value)
            series.append({"name": signal.name, "t": block.times(t_s), "y": block.values(value)})
        if series:
            limits = [
                {"value": limit.value, "text": limit.text, "kind": limit.kind}
                for limit in page.limits.get(panel.key, ())
            ]
            panels.append(
                {
                    "key": panel.key,
                    "unit": panel.unit,
                    "log": panel.log,
                    "series": series,
                    "limits": limits,
                }
            )
    starts = [signal.t_s[0] for signal in recording.signals] + [s.start_s for s in recording.spans]
    ends = [signal.t_s[-1] for signal in recording.signals] + [s.end_s for s in recording.spans]
    start = float(min(starts, default=0.0))
    model = {
        "start": start,
        "end": max(float(max(ends, default=1.0)), start + 1e-3),
        "panels": panels,
        "spans": [
            {"lane": s.lane, "start": s.start_s, "end": s.end_s, "text": s.text, "kind": s.kind}
            for s in sorted(recording.spans, key=lambda span: _lane_rank(span.lane))
        ],
        "tracks": _tracks(_flown(recording), block),
    }
    with_plots = {BY_KEY[str(panel["key"])].section for panel in panels}
    with_tables = {section for section, _ in page.tables if section}
    sections = list(dict.fromkeys(panel.section for panel in PANELS))
    sections = [name for name in sections if name in with_plots | with_tables]
    first = []
    if recording.spans or recording.events or TIMELINE in with_tables:
        first.append(TIMELINE)
    if CHECKS in with_tables:
        first.append(CHECKS)
    if recording.tracks:
        first.append("Map")
    sections = first + [name for name in sections if name not in first]
    return model, sections + sorted(with_tables - set(sections))


def _lane_rank(lane: str) -> int:
    """Injected first, then what was detected, flags, modes."""
    order = ("injected", "detected", "excluded", "found", "estimator", "mode", "armed")
    return next((i for i, word in enumerate(order) if lane.startswith(word)), len(order))


def _flown(recording: Recording) -> list[Track]:
    """Tracks while armed, where the log says when: before, there may be no position yet."""
    armed = armed_windows(recording)
    if not armed:
        return recording.tracks
    found = []
    for track in recording.tracks:
        inside = np.zeros(len(track.t_s), bool)
        for start, end in armed:
            inside |= (track.t_s >= start - MARGIN_S) & (track.t_s <= end + MARGIN_S)
        if inside.sum() > 1:
            columns = (track.t_s, track.lat_deg, track.lon_deg, track.alt_m)
            found.append(Track(track.name, *(column[inside] for column in columns)))
    return found


def _tracks(tracks: Sequence[Track], block: Block) -> list[dict[str, Any]]:
    """Tracks in metres east, north and up of the first one's first point."""
    if not tracks:
        return []
    lat0, lon0 = float(tracks[0].lat_deg[0]), float(tracks[0].lon_deg[0])
    found = []
    for track in tracks:
        places: dict[str, Any] = {"name": track.name}
        east = np.radians(track.lon_deg - lon0) * EARTH_RADIUS_M * np.cos(np.radians(lat0))
        north = np.radians(track.lat_deg - lat0) * EARTH_RADIUS_M
        step = max(1, len(track.t_s) // 20_000)
        axes: tuple[tuple[str, Vector], ...] = (("e", east), ("n", north), ("u", track.alt_m))
        places["t"] = block.times(track.t_s[::step])
        for name, values in axes:
            places[name] = block.values(values[::step])
        found.append(places)
    return found


def _overview(page: Page, recording: Recording) -> str:
    facts = "".join(
        f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>"
        for name, value in page.facts
    )
    reasons = "".join(
        f'<li><b class="{_css(kind)}">{escape(kind)}</b> {escape(text)}</li>'
        for kind, text in page.reasons
    )
    reasons = f'<ul class="reasons">{reasons}</ul>' if reasons else ""
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in recording.notes)
    tables = "".join(_table(table) for section, table in page.tables if section == "")
    return (
        f'<section id="to-overview">{reasons}<div class="facts">{facts}</div>{notes}{tables}'
        "</section>"
    )


def _section(section: str, page: Page, recording: Recording, model: Mapping[str, Any]) -> list[str]:
    parts = []
    if section == TIMELINE and recording.spans:
        parts.append(
            '<div class="plot"><div class="readout" id="timeline-readout"></div>'
            '<div class="area" id="timeline"></div></div>'
            '<p class="note hint">Drag over any plot to zoom all of them; double click for the '
            "whole flight; click a legend entry to hide its curve.</p>"
        )
    if section == "Map":
        parts.append(
            '<div class="key" id="track-key"></div><div class="tracks">'
            '<canvas id="map"></canvas><canvas id="space"></canvas></div>'
            '<p class="note hint">Drag to move (left) or turn (right), wheel to zoom, double click '
            "to reset.</p>"
        )
    for entry in model["panels"]:
        panel = BY_KEY[entry["key"]]
        if panel.section == section:
            parts.append(
                f'<div class="plot"><h3>{escape(panel.title)}</h3>'
                f'<div class="area" id="plot-{panel.key}"></div></div>'
            )
    parts.extend(_table(table) for name, table in page.tables if name == section)
    if section == TIMELINE:
        parts.append(_events(recording))
    return parts


def _events(recording: Recording) -> str:
    rows = [
        (f"{event.t_s:.2f}", event.kind, (event.text, "FAIL" if event.severity <= 2 else ""))
        for event in recording.events[:EVENTS_SHOWN]
    ]
    if not rows:
        return ""
    left = len(recording.events) - len(rows)
    note = f"{left} more are in the JSON file." if left else ""
    title = f"Events and messages ({len(recording.events)})"
    return _table(Table(title, ("t, s", "kind", "text"), rows, note, folded=len(rows) > 12))


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.head)
    rows = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in table.rows)
    text = (
        f'<div class="wide"><table class="{table.style}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )
    if table.note:
        text += f'<p class="note">{escape(table.note)}</p>'
    if table.folded:
        return f"<details><summary>{escape(table.title)}</summary>{text}</details>"
    return f"<h3>{escape(table.title)}</h3>{text}"


def _cell(cell: str | tuple[str, str]) -> str:
    text, style = cell if isinstance(cell, tuple) else (cell, "")
    number = text.replace(".", "", 1).replace("-", "", 1).isdigit()
    styles = " ".join(filter(None, (style, "number" if number else "")))
    return f'<td class="{styles}">{escape(text)}</td>' if styles else f"<td>{escape(text)}</td>"
