"""Render a report as one self-contained HTML file.

The file contains uPlot (MIT, see `assets/uPlot.LICENSE`), the style and the scripts, so it needs no
network; its content security policy allows nothing else.
"""

import base64
import hashlib
import json
from html import escape
from string import Template

from analysis.report.curves.recording import FlightData
from analysis.report.page.field_data import FieldData
from analysis.report.page.packed_numbers import PackedNumbers
from analysis.report.page.page_body import (
    css_class,
    overview_html,
    read_asset,
    read_markup,
    section_anchor,
    section_html,
    sections_of,
)
from analysis.report.page.page_model import page_model
from analysis.report.page.page_parts import ReportPage

SCRIPTS = (
    "uPlot.iife.min.js", "time.js", "plots.js", "lanes.js", "spectra.js", "tracks.js",
    "expressions.js", "fields.js", "page.js",
)  # fmt: skip
STYLES = ("uPlot.min.css", "page.css")


def page_html(page: ReportPage, recording: FlightData, fields: FieldData | None = None) -> str:
    """The complete HTML file; `fields` are the numbers of all message fields."""
    numbers = PackedNumbers()
    model = page_model(page, recording, numbers)
    fields = fields or FieldData()
    # The index is part of the model; the numbers are in blocks that the page unpacks on demand.
    model["fields"] = fields.index
    sections = sections_of(page, recording, model, bool(fields.index))
    links = "".join(
        f'<a href="#{section_anchor(name)}">{escape(name)}</a>' for name in ("Overview", *sections)
    )
    script = "\n".join(map(read_asset, SCRIPTS))
    style = "".join(map(read_asset, STYLES))
    blocks = "".join(
        # `text/plain` is never executed, so it needs no hash in the policy.
        f'<script type="text/plain" id="fields-{number}">{text}</script>'
        for number, text in fields.inside.items()
    )
    body = Template(read_markup("report.html")).substitute(
        title=escape(page.title),
        verdict_class=css_class(page.verdict),
        verdict=escape(page.verdict),
        links=links,
        overview=overview_html(page, recording),
        sections="".join(section_html(name, page, recording, model) for name in sections),
        model=embedded_json(model),
        numbers=numbers.text(),
        blocks=blocks,
        licence=read_asset("uPlot.LICENSE"),
    )
    return html_document(page.title, style, body, script)


def html_document(title: str, style: str, body: str, script: str) -> str:
    """A complete HTML file that needs no network, and loads nothing from it."""
    # The policy must precede the scripts and styles.
    policy = security_policy(script, style)
    return Template(read_markup("document.html") + "\n").substitute(
        policy=policy, title=escape(title), style=style, body=body, script=script
    )


def embedded_json(value: object) -> str:
    """JSON for a block of a page."""
    # `</script>` within a string would end the block.
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def security_policy(script: str, style: str) -> str:
    """Content security policy: only the file's own script and style, and data files beside it."""
    hashes = [
        # SHA-256 of the exact text between the tags, else the browser refuses it.
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in (script, style)
    ]
    policy = (
        # 'self' and file: allow the scripts in `report-data/` beside the page.
        f"default-src 'none'; script-src 'sha256-{hashes[0]}' 'self' file:; "
        f"style-src 'sha256-{hashes[1]}'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
