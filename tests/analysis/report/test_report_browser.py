"""A report opens in a browser without an error, and its plots draw."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.cli import main

Flight = Callable[..., Path]

pytestmark = pytest.mark.browser

INKED = """(area) => {
  const canvas = area.querySelector('canvas') || area;
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let inked = 0;
  for (let i = 3; i < data.length; i += 4) inked += data[i] > 0;
  return inked;
}"""


class Opened:
    """A page with everything its console and its network said."""

    def __init__(self, browser: Any, path: Path) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page = browser.new_page(viewport={"width": 1200, "height": 900})
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready=yes]", state="attached")

    def _console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.errors.append(message.text)


@pytest.fixture
def opened(browser: Any, flight: Flight, tmp_path: Path) -> Iterator[Opened]:
    labels = tmp_path / "labels.jsonl"
    labels.write_text(
        '{"id":"j","fault":"bias","t0_us":1000000,"start_us":11000000,"end_us":16000000}\n'
    )
    out = tmp_path / "out"
    main(["report", str(flight(jump_at_s=10.0)), "--labels", str(labels), "--out", str(out)])
    found = Opened(browser, out / "report.html")
    yield found
    found.page.close()


def test_a_report_opens_without_errors_and_asks_for_nothing(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    assert opened.errors == []
    assert [url for url in opened.requests if not url.startswith("file:")] == []


def test_every_plot_and_both_tracks_have_drawn(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    opened.page.wait_for_function("report.axis.plots.size === report.page.panels.length + 1")
    opened.page.wait_for_timeout(50)  # uPlot draws in the next microtask
    areas = opened.page.query_selector_all(".area, #map, #space")
    assert len(areas) >= 12
    assert min(area.evaluate(INKED) for area in areas) > 500


def test_plots_draw_by_themselves_when_they_come_into_view(opened: Opened) -> None:
    last = opened.page.query_selector_all(".area")[-1]
    assert last.get_attribute("data-drawn") is None
    last.scroll_into_view_if_needed()
    opened.page.wait_for_function("(area) => area.dataset.drawn === 'yes'", arg=last)


def test_zooming_one_plot_zooms_them_all_and_the_button_goes_back(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    opened.page.locator("#timeline").scroll_into_view_if_needed()
    box = opened.page.locator("#timeline .u-over").bounding_box()
    mouse = opened.page.mouse
    y = box["y"] + box["height"] / 2
    mouse.move(box["x"] + 0.5 * box["width"], y)
    mouse.down()
    mouse.move(box["x"] + 0.75 * box["width"], y, steps=4)
    mouse.up()
    ranges = "[...report.axis.plots].map((p) => [p.scales.x.min, p.scales.x.max])"
    opened.page.wait_for_function("report.axis.range[0] > report.axis.full[0] + 5")
    zoomed = opened.page.evaluate(ranges)
    assert all(one == pytest.approx(zoomed[0]) for one in zoomed)
    assert zoomed[0] == pytest.approx([9.9, 14.9], abs=0.5)
    opened.page.click("#reset")
    opened.page.wait_for_function("report.axis.range[0] === report.axis.full[0]")
    assert opened.errors == []


def test_hovering_shows_values_and_a_legend_entry_hides_its_curve(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    plot = opened.page.locator("#plot-roll")
    plot.scroll_into_view_if_needed()
    plot.locator(".u-over").hover()
    opened.page.wait_for_function(
        "document.querySelector('#plot-roll .u-series:nth-child(2) .u-value')"
        ".textContent.startsWith('5.7')"
    )
    plot.locator(".u-series").nth(1).locator("th").click()
    assert "u-off" in (plot.locator(".u-series").nth(1).get_attribute("class") or "")


def test_the_dark_theme_and_print_redraw_without_errors(opened: Opened) -> None:
    opened.page.emulate_media(color_scheme="dark")
    assert opened.page.evaluate("getComputedStyle(document.body).backgroundColor") == (
        "rgb(20, 23, 27)"
    )
    pdf = opened.page.pdf()
    assert pdf.startswith(b"%PDF")
    assert opened.errors == []
