"""Measure the size of a report and its opening time in a newly started browser.

    python benchmarks/report.py                              # ten curves of 60,000 noisy samples
    python benchmarks/report.py --log hil.tlog --megabytes 500   # a log repeated to that size

Needs Debian's chromium and Playwright. "Opened" is the time until the visible plots are drawn, "all
drawn" until every plot is.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from analysis.report.curves.recording import FlightData, Signal
from analysis.report.page.page_file import page_html
from analysis.report.page.page_parts import ReportPage
from mavproxy_fault.wire import tlog

SAMPLES, PANELS = 60_000, ("roll", "pitch", "yaw", "accel", "gyro")
TIMES = 3


def recording() -> FlightData:
    rng = np.random.default_rng(1)
    t_s = np.arange(SAMPLES) * 0.004 + rng.normal(0, 1e-4, SAMPLES)
    return FlightData(
        "benchmark",
        signals=[
            Signal(panel, name, t_s, np.cumsum(rng.normal(0, 0.1, SAMPLES)))
            for panel in PANELS
            for name in ("one", "two")
        ],
    )


def repeated(log: Path, megabytes: int, path: Path) -> None:
    """Write a log repeatedly, with shifted timestamps."""
    records = [(t_us, raw) for t_us, raw, _ in tlog.read_records(log)]
    length_us = records[-1][0] - records[0][0] + 10_000
    with path.open("wb") as file:
        moved_us = 0
        while file.tell() < megabytes * 1_000_000:
            file.write(b"".join(tlog.log_record(t_us + moved_us, raw) for t_us, raw in records))
            moved_us += length_us


def reported(log: Path, megabytes: int, folder: Path) -> Path:
    """Run the report command on a log of that size."""
    large = folder / "large.tlog"
    repeated(log, megabytes, large)
    start_s = time.perf_counter()
    command = ["mavproxy-fault", "report", str(large), "--out", str(folder)]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    memory_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1000
    print(f"reported in {time.perf_counter() - start_s:.1f} s, {memory_mb:.0f} MB of memory")
    return folder / "report.html"


def open_in_browser(path: Path) -> None:
    from playwright.sync_api import sync_playwright

    print(f"{path.stat().st_size / 1e6:.2f} MB")
    for _ in range(TIMES):
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path="/usr/bin/chromium",
                args=["--headless", "--no-sandbox", "--disable-gpu"],
            )
            page = browser.new_page(viewport={"width": 1200, "height": 900})
            start_s = time.perf_counter()
            page.goto(path.as_uri())
            page.wait_for_selector("html[data-ready=yes]", state="attached")
            opened_s = time.perf_counter() - start_s
            page.evaluate("report.all()")
            print(f"opened {opened_s:.2f} s, all drawn {time.perf_counter() - start_s:.2f} s")
            browser.close()


def main() -> int:
    """Write a report and open it several times."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--log", type=Path, help="a tlog (default: curves made here)")
    parser.add_argument("--megabytes", type=int, default=500, help="repeat the log up to this size")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.log is not None:
            open_in_browser(reported(args.log, args.megabytes, folder))
            return 0
        start_s = time.perf_counter()
        text = page_html(ReportPage("benchmark", "PASS", [], []), recording())
        print(f"written in {time.perf_counter() - start_s:.2f} s")
        path = folder / "report.html"
        path.write_text(text, encoding="utf-8")
        open_in_browser(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
