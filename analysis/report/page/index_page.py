"""Render the index page of many flights: one row each, sortable and filterable."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from analysis.report.page.page_body import css_class
from analysis.report.page.page_file import html_document, read_asset

HEAD = ("verdict", "flight", "duration, s", "autopilot", "worst checks")
UNREADABLE = "unreadable"


def index_html(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The complete HTML file; `rows` as in `log_folder`, links relative to the file."""
    script, style = read_asset("index.js"), read_asset("page.css")
    head = "".join(f"<th><button>{escape(name)}</button></th>" for name in HEAD)
    counts: dict[str, int] = {}
    for row in rows:
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    facts = "".join(
        f'<div><b class="{css_class(word)}">{count}</b><span>{escape(word)}</span></div>'
        for word, count in sorted(counts.items())
    )
    body = (
        f"<header><h1>{escape(title)}</h1></header><main>"
        f'<div class="facts"><div><b>{len(rows)}</b><span>flights</span></div>{facts}</div>'
        '<p><label>Show rows with <input id="filter" placeholder="FAIL, vibration, ..."></label> '
        '<span id="shown" class="note" role="status"></span></p>'
        f'<div class="wide"><table id="flights"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(map(_row, rows))}</tbody></table></div></main>"
    )
    return html_document(title, style, body, script)


def _row(row: Mapping[str, Any]) -> str:
    name = escape(row["name"])
    link = f'<a href="{quote(row["report"])}">{name}</a>' if row["report"] else name
    worst = "<br>".join(map(escape, row["worst"]))
    verdict = escape(row["verdict"])
    duration = "" if row["duration_s"] is None else f"{row['duration_s']:.0f}"
    return (
        f'<tr><td class="{css_class(row["verdict"])}">{verdict}</td><td>{link}</td>'
        f'<td class="number">{duration}</td><td>{escape(row["autopilot"])}</td>'
        f"<td>{worst}</td></tr>"
    )
