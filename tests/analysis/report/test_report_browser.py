"""A report opens in a browser without an error, and its plots draw."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from analysis.report.page.index_page import UNREADABLE, index_html
from analysis.report.run_report import write_run_report
from analysis.results import Decision
from mavproxy_fault.cli import main

Flight = Callable[..., Path]

pytestmark = pytest.mark.browser

# The last plot may be any: those below the window are drawn meanwhile.
FIELD_PLOT = "[...report.axis.plots].find((p) => p.root.closest('#field-plots'))"
INKED = """(area) => {
  const canvas = area.querySelector('canvas') || area;
  const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let inked = 0;
  for (let i = 3; i < data.length; i += 4) inked += data[i] > 0;
  return inked;
}"""


class Opened:
    """A page, its console messages and its network requests."""

    def __init__(self, browser: Any, path: Path) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page = browser.new_page(viewport={"width": 1200, "height": 900})
        self.page.on("console", self._console)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.open(path)

    def open(self, path: Path) -> None:
        """Open a report anew."""
        self.page.goto("about:blank")  # or an address that differs by its hash would not load
        self.errors.clear()
        self.requests.clear()
        self.page.emulate_media(color_scheme="light")
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-ready=yes]", state="attached")

    def _console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.errors.append(message.text)


@pytest.fixture(scope="module")
def report(
    browser: Any, flight_in: Flight, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Opened, Path]]:
    """A report of a flight whose position jumps, open in the one page of these tests."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "labels.jsonl").write_text(
        '{"id":"j","fault":"bias","t0_us":1000000,"start_us":11000000,"end_us":16000000}\n'
    )
    log = str(flight_in(folder, jump_at_s=10.0))
    labels = ["--labels", str(folder / "labels.jsonl")]
    main(["report", log, *labels, "--out", str(folder / "out")])
    found = Opened(browser, folder / "out" / "report.html")
    yield found, folder / "out" / "report.html"
    found.page.close()


@pytest.fixture
def opened(report: tuple[Opened, Path]) -> Opened:
    found, path = report
    found.open(path)
    return found


def test_nobody_is_kept_from_a_report(
    opened: Opened, find_barriers: Callable[[Any], list[str]]
) -> None:
    assert find_barriers(opened.page) == []


def test_nobody_is_kept_from_the_index_of_many_flights(
    browser: Any, tmp_path: Path, find_barriers: Callable[[Any], list[str]]
) -> None:
    row = {
        "verdict": "FAIL", "name": "flight", "report": "flight/report.html", "duration_s": 60.0,
        "autopilot": "px4", "worst": ["vibration: peak 80 m/s² at 31.2 s, 99th percentile 4.9"],
    }  # fmt: skip
    unread = {**row, "verdict": UNREADABLE, "report": "", "duration_s": None, "autopilot": ""}
    (tmp_path / "index.html").write_text(index_html("fleet", [row, unread]), encoding="utf-8")
    page = browser.new_page()
    page.goto((tmp_path / "index.html").as_uri())
    assert find_barriers(page) == []
    page.close()


def test_a_report_opens_without_errors_and_loads_nothing(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    assert opened.errors == []
    assert [url for url in opened.requests if not url.startswith("file:")] == []


def test_every_plot_and_both_tracks_have_drawn(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    opened.page.wait_for_function("() => report.axis.plots.size === report.page.panels.length + 1")
    opened.page.wait_for_timeout(50)  # uPlot draws in the next microtask
    areas = opened.page.query_selector_all(".area, #map, #space")
    assert len(areas) >= 12
    assert min(area.evaluate(INKED) for area in areas) > 500


def test_a_logarithmic_plot_has_a_range_that_its_curves_can_be_drawn_in(
    browser: Any, tmp_path: Path
) -> None:
    """A grid without curves has ink enough for the test above."""
    decisions = [
        Decision(
            t_us=t * 1_000_000, statistic=3.0 + 40.0 * (10 <= t < 20), threshold=18.5,
            dof=2, p_value=None, alarm=10 <= t < 20, hypothesis="none", excluded=(),
            satellites=("G01",), residual_m=(0.5,),
        )
        for t in range(30)
    ]  # fmt: skip
    page = Opened(
        browser,
        write_run_report(
            tmp_path, summary={"verdict": "PASS"}, labels=[], results=decisions, columns={}
        ),
    ).page
    page.evaluate("report.all()")
    page.wait_for_timeout(50)
    logarithmic = "[...report.axis.plots].map((p) => p.scales.y).filter((y) => y.distr === 3)"
    assert page.evaluate(f"({logarithmic}).map((y) => Number.isFinite(y.max - y.min))") == [True]
    page.close()


def test_plots_below_the_window_are_drawn_too_and_nothing_moves(opened: Opened) -> None:
    top = "[...document.querySelectorAll('.section')].at(-1).getBoundingClientRect().y"
    before = opened.page.evaluate(top)
    opened.page.wait_for_function(
        "() => [...document.querySelectorAll('.plots .area')].every((a) => a.dataset.drawn)"
    )
    plots = opened.page.evaluate("document.querySelectorAll('.plots .area').length")
    # Legends of several lines are higher than the reserved space.
    assert opened.page.evaluate(top) == pytest.approx(before, abs=25.0 * plots)


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
    opened.page.wait_for_function("() => report.axis.range[0] > report.axis.full[0] + 5")
    zoomed = opened.page.evaluate(ranges)
    assert all(one == pytest.approx(zoomed[0]) for one in zoomed)
    assert zoomed[0] == pytest.approx([9.9, 14.9], abs=0.5)
    opened.page.click("#reset")
    opened.page.wait_for_function("() => report.axis.range[0] === report.axis.full[0]")
    assert opened.errors == []


def test_hovering_shows_values_and_a_legend_entry_hides_its_curve(opened: Opened) -> None:
    opened.page.evaluate("report.all()")
    plot = opened.page.locator("#plot-roll")
    plot.scroll_into_view_if_needed()
    plot.locator(".u-over").hover()
    opened.page.wait_for_function(
        "() => document.querySelector('#plot-roll .u-series:nth-child(2) .u-value')"
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


def test_any_field_and_an_expression_are_plotted_and_the_address_keeps_them(
    opened: Opened, browser: Any
) -> None:
    page = opened.page
    page.fill("#field-text", "ATTITUDE.roll, deg(ATTITUDE.roll) - 2 * hypot(3, 4)")
    page.click("#field-form button")
    page.wait_for_selector("#field-plots .area[data-drawn]")
    values = page.evaluate(f"{FIELD_PLOT}.data.slice(1).map((y) => y[5])")
    assert values == pytest.approx([0.1, 5.7296 - 10], abs=1e-4)
    page.evaluate("report.axis.set(6, 9)")
    page.select_option("#time-form", "hms")
    page.wait_for_function("() => location.hash.includes('time=hms')")
    address = page.evaluate("location.href")
    again = browser.new_page()
    again.goto(address)
    again.wait_for_selector("html[data-ready=yes]", state="attached")
    assert again.evaluate("report.axis.range") == [6, 9]
    assert again.evaluate("report.axis.text(3725.5, 1)") == "1:02:05.5"
    assert again.locator("#field-plots .plot h3").inner_text().startswith("ATTITUDE.roll, deg")
    again.close()
    page.click("#field-plots button")
    page.wait_for_function("() => !location.hash.includes('plot=')")
    assert page.locator("#field-plots .plot").count() == 0
    assert opened.errors == []


def test_a_missing_field_is_explained(opened: Opened) -> None:
    for text, said in (
        ("ATTITUDE.rol", "has no field rol; it has"),
        ("ALTITUDE.roll", "no message ALTITUDE"),
        ("deg(ATTITUDE.roll", "bracket is not closed"),
        ("alert(1)", "is not a field, number or function"),
        ("ATTITUDE.roll )", "is not expected after the expression"),
    ):
        opened.page.fill("#field-text", text)
        opened.page.click("#field-form button")
        opened.page.wait_for_function(
            "(said) => document.getElementById('field-said').textContent.includes(said)", arg=said
        )


def test_fields_beside_the_file_are_loaded_on_demand(
    browser: Any, flight: Flight, tmp_path: Path
) -> None:
    out = tmp_path / "beside"
    main(["report", str(flight()), "--data", "beside", "--out", str(out)])
    opened = Opened(browser, out / "report.html")
    assert not [url for url in opened.requests if "report-data" in url]
    opened.page.fill("#field-text", "VFR_HUD.throttle")
    opened.page.click("#field-form button")
    opened.page.wait_for_selector("#field-plots .area[data-drawn]")
    assert opened.page.evaluate(f"{FIELD_PLOT}.data[1][3]") == 40
    assert opened.errors == []
    opened.page.close()


def test_a_click_on_a_checks_time_shows_that_stretch_and_its_plot(opened: Opened) -> None:
    button = opened.page.locator("button.moment[data-panel=estimate-jump]").first
    # An injected fault explains the jump, and checks that pass are folded.
    button.evaluate("one => { one.closest('details').open = true }")
    button.click()
    start, end = opened.page.evaluate("report.axis.range")
    assert start < 10 < end
    assert end - start < 4
    opened.page.wait_for_selector("#plot-estimate-jump[data-drawn]")
    assert opened.page.locator("#plot-estimate-jump").is_visible()


def test_a_script_injected_by_a_log_is_not_run(opened: Opened) -> None:
    opened.page.evaluate(
        "document.body.append(Object.assign(document.createElement('script'),"
        " { textContent: 'window.smuggled = 1' }))"
    )
    assert opened.page.evaluate("window.smuggled") is None


def test_sections_are_folded_on_a_narrow_screen_and_nothing_is_too_wide(
    browser: Any, opened: Opened
) -> None:
    narrow = browser.new_page(viewport={"width": 390, "height": 800})
    narrow.goto(opened.page.url)
    narrow.wait_for_selector("html[data-ready=yes]", state="attached")
    assert narrow.evaluate("document.getElementById('to-timeline').open")
    assert not narrow.evaluate("document.getElementById('to-gps').open")
    assert narrow.evaluate("document.documentElement.scrollWidth") <= 390
    narrow.close()


def test_tracks_take_the_colour_of_any_curve(opened: Opened) -> None:
    page = opened.page
    page.evaluate("report.all()")
    before = page.evaluate("document.getElementById('map').toDataURL()")
    page.select_option("#track-value", label="VFR_HUD")
    assert page.evaluate("document.getElementById('map').toDataURL()") != before
    assert "bright" in page.inner_text("#track-key")
    assert opened.errors == []


def test_a_report_is_printed_as_pdf(browser: Any, flight: Flight, tmp_path: Path) -> None:
    out = tmp_path / "printed"
    main(["report", str(flight(seconds=5)), "--pdf", "--out", str(out)])
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")


def test_without_a_browser_pdf_is_refused(
    flight: Flight,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["report", str(flight(seconds=5)), "--pdf", "--out", str(tmp_path / "out")]) == 2
    assert "--pdf: no browser found; install one of chromium" in capsys.readouterr().err


def test_spectra_of_a_real_log_are_drawn_with_their_filters(
    browser: Any, shared_data: Path, tmp_path: Path
) -> None:
    out = tmp_path / "real"
    main(["report", str(shared_data / "ulog" / "gps_interference.ulg"), "--out", str(out)])
    real = Opened(browser, out / "report.html")
    real.page.evaluate("report.all()")
    real.page.wait_for_timeout(50)
    areas = real.page.query_selector_all("[id^=plot-spectrum]")
    # Gyroscopes, rates, accelerometers and torques: a density, and by time and by throttle.
    assert len(areas) == 4 * 3
    assert min(area.evaluate(INKED) for area in areas) > 2000
    assert ["gyro low-pass", 40.0] in [
        [text, hz] for hz, text in real.page.evaluate("report.page.frequencies")
    ]
    assert real.errors == []
    real.page.close()
