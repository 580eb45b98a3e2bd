"""Render the index page of many flights: one row each, sortable and filterable."""

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from string import Template
from typing import Any
from urllib.parse import quote

from analysis.report.page.page_body import css_class, read_asset, read_markup
from analysis.report.page.page_file import html_document

HEAD = ("verdict", "flight", "duration, s", "autopilot", "worst checks")
UNREADABLE = "unreadable"


def index_html(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """The complete HTML file; `rows` as in `log_folder`, links relative to the file."""
    script, style = read_asset("index.js"), read_asset("page.css")
    head = "".join(f"<th><button>{escape(name)}</button></th>" for name in HEAD)
    facts = "".join(
        f'<div><b class="{css_class(word)}">{count}</b><span>{escape(word)}</span></div>'
        for word, count in sorted(Counter(row["verdict"] for row in rows).items())
    )
    body = Template(read_markup("flights.html")).substitute(
        title=escape(title), count=len(rows), facts=facts, head=head, rows="".join(map(_row, rows))
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
