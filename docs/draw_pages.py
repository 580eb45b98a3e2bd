"""Take the pictures of our pages that docs/ shows, in Debian's Chromium.

python docs/draw_pages.py [DATA]

DATA is a folder of real logs (px4_hil, tlog, ulog); without it the pictures of their reports stay.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import yaml
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from mavproxy_fault.wire.label import Label

DOCS = Path(__file__).parent
CAMPAIGN = DOCS.parent / "examples" / "campaign_estimators.yaml"
SEARCH = DOCS.parent / "examples" / "gyro_search.yaml"
SEQUENCE = DOCS.parent / "examples" / "test_sequence.yaml"
COMMAND = [sys.executable, "-P", "-m", "mavproxy_fault.cli"]
REPORTS = {
    "report_px4_gps_jump.png": "px4_hil/hover_gps_jump_hil.tlog px4_hil/hover_gps_jump_gcs.tlog",
    "report_tlog.png": "tlog/dronekit_flight_replay.tlog",
    "report_ulog.png": "ulog/gps_interference.ulg",
}
# What acted in hover_gps_jump, which was recorded without a proxy.
JUMP = Label(
    id="gps-jump", fault="bias", targets=("HIL_GPS.lat",), t0_us=1_000_000,
    start_us=41_000_000, end_us=56_000_000, frames=75,
)  # fmt: skip
MINUTES = 60_000.0  # ms


def open_page(browser: Browser, address: str, width: int, scheme: Any = "light") -> Page:
    """A page whose screen is as wide as the picture."""
    page = browser.new_page(viewport={"width": width, "height": 1060}, color_scheme=scheme)
    page.set_default_timeout(3 * MINUTES)
    page.goto(address)
    return page


def take(page: Page, name: str, height: int | None = None, below: str = "") -> None:
    """Save the page's first `height` pixels, or what is above the element `below`."""
    page.wait_for_timeout(2000)
    if below:
        height = int(page.locator(below).bounding_box()["y"]) - 8  # type: ignore[index]
    width = page.viewport_size["width"]  # type: ignore[index]
    clip: Any = {"x": 0, "y": 0, "width": width, "height": height}
    page.screenshot(path=DOCS / name, full_page=True, clip=clip)
    reduce_colours(DOCS / name)
    page.close()


def reduce_colours(path: Path) -> None:
    """A third of the bytes, and no difference to the eye."""
    Image.open(path).convert("RGB").quantize(256).save(path, optimize=True)


@contextmanager
def started(folder: Path, *words: str) -> Iterator[str]:
    """A command that shows a page, and the address that it prints."""
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True, cwd=folder)
    assert process.stdout is not None
    try:
        yield next(line for line in process.stdout if "http://" in line).split()[-1]
    finally:
        process.terminate()
        process.communicate()


def draw_reports(browser: Browser, folder: Path, data: Path | None) -> None:
    """The demo's report, and those of real logs."""
    command = [*COMMAND, "run", "--zenoh", "off", "--out", "0001-demo"]
    subprocess.run(command, cwd=folder, check=False)
    demo = (folder / "0001-demo" / "report.html").as_uri()
    take(open_page(browser, demo, 1000), "report_demo.png", below="summary:has-text('Checks')")
    labels = folder / "labels.jsonl"
    labels.write_bytes(msgspec.json.encode(JUMP) + b"\n")
    for name, words in REPORTS.items() if data else ():
        command = [*COMMAND, "report", *words.split(), "--out", str(folder / name)]
        command += ["--labels", str(labels)] if "jump" in name else []
        subprocess.run(command, cwd=data, check=False)
        scheme = "dark" if "ulog" in name else "light"
        page = open_page(browser, (folder / name / "report.html").as_uri(), 1200, scheme)
        take(page, name, 1900)


def draw_flight(browser: Browser, folder: Path) -> None:
    """The page of the demo while a gyro's fault is found, on three screens."""
    with started(folder, "run", "--ui") as address:
        kinds = (("page.png", 1500, "light"), ("page_dark.png", 1500, "dark"))
        pages = [(name, open_page(browser, address, *screen)) for name, *screen in kinds]
        pages += [("page_narrow.png", open_page(browser, address, 380))]
        for name, page in pages:
            page.wait_for_selector("#verdict.alarm:has-text('IMU')")
            take(page, name, 1060)


def draw_sequence(browser: Browser, folder: Path) -> None:
    """A test sequence that runs, on the page of a flight."""
    with started(folder, "run", str(SEQUENCE), "--ui") as address:
        page = open_page(browser, address, 360)
        # Otherwise the page's header would cover the part that is taken.
        page.set_viewport_size({"width": 360, "height": 4000})
        page.click("#sequence summary")
        schedule = folder / "sequence.yaml"
        schedule.write_text(yaml.safe_dump(yaml.safe_load(SEQUENCE.read_text())["schedule"]))
        page.wait_for_selector("#links-title:not([hidden])")
        page.set_input_files("#open-sequence", schedule)
        page.wait_for_selector("#steps li >> nth=3")
        page.click("#run-sequence")
        page.wait_for_selector("#sequence-state:has-text('running: drift')")
        page.wait_for_timeout(2000)
        page.locator("#sequence").screenshot(path=DOCS / "page_sequence.png")
        reduce_colours(DOCS / "page_sequence.png")
        page.close()


def draw_campaign(browser: Browser, folder: Path) -> None:
    """The page of a campaign half way, then as it is at the end."""
    out = folder / "campaign"
    with subprocess.Popen([*COMMAND, "campaign", str(CAMPAIGN), "--out", str(out)]) as process:
        while not (page := out / "campaign.html").exists():
            process.poll()
        shown = open_page(browser, page.as_uri(), 1200)
        shown.wait_for_function("/1[4-6]\\d of \\d+/.test(document.body.innerText)")
        take(shown, "campaign_live.png", 900)
    take(open_page(browser, page.as_uri(), 1740), "campaign_estimators.png", 1310)


def draw_search(browser: Browser, folder: Path) -> None:
    """The page of a search, at the first flight that stays in the envelope."""
    with started(folder, "search", str(SEARCH), "--interactive") as address:
        page = open_page(browser, address, 1400)
        while "error of" not in (shown := page.inner_text("#title")):
            page.click("#next:not([disabled])")
            page.wait_for_function("before => $('title').textContent !== before", arg=shown)
        page.click("#save:not([disabled])")
        page.wait_for_selector("#message:has-text('yaml')")
        take(page, "search_page.png", 1187)


def main() -> None:
    """Take all pictures."""
    data = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else None
    chromium = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for draw in (draw_flight, draw_sequence, draw_search, draw_campaign):
            draw(browser, Path(folder))
        draw_reports(browser, Path(folder), data)


if __name__ == "__main__":
    main()
