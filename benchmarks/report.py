"""How large a report is and how fast it opens: ten curves of 60,000 noisy samples in five plots.

    python benchmarks/report.py

Needs Debian's chromium and Playwright. "Opened" is until the page is ready with what is in view
drawn, "all drawn" until every plot is.
"""

import tempfile
import time
from pathlib import Path

import numpy as np

from analysis.report.page.page_file import html
from analysis.report.page.page_parts import Page
from analysis.report.recordings.recording import Recording, Signal

SAMPLES, PANELS = 60_000, ("roll", "pitch", "yaw", "accel", "gyro")


def recording() -> Recording:
    rng = np.random.default_rng(1)
    t_s = np.arange(SAMPLES) * 0.004 + rng.normal(0, 1e-4, SAMPLES)
    return Recording(
        "benchmark",
        signals=[
            Signal(panel, name, t_s, np.cumsum(rng.normal(0, 0.1, SAMPLES)))
            for panel in PANELS
            for name in ("one", "two")
        ],
    )


def main() -> None:
    from playwright.sync_api import sync_playwright

    start_s = time.perf_counter()
    text = html(Page("benchmark", "PASS", [], []), recording())
    print(f"written in {time.perf_counter() - start_s:.2f} s, {len(text) / 1e6:.2f} MB")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "report.html"
        path.write_text(text, encoding="utf-8")
        browser = playwright.chromium.launch(
            executable_path="/usr/bin/chromium",
            args=["--headless", "--no-sandbox", "--disable-gpu"],
        )
        for _ in range(3):
            page = browser.new_page(viewport={"width": 1200, "height": 900})
            start_s = time.perf_counter()
            page.goto(path.as_uri())
            page.wait_for_selector("html[data-ready=yes]", state="attached")
            opened_s = time.perf_counter() - start_s
            page.evaluate("report.all()")
            print(f"opened {opened_s:.2f} s, all drawn {time.perf_counter() - start_s:.2f} s")
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
