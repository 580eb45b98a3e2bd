"""A browser that shows the page, and the cost of its scripts, memory and frames.

    python -m tests.hardening.page_watcher 'http://127.0.0.1:8350/#token=...' --seconds 30

Debian's Chromium without a window and without a graphics card. The work of a frame is the processor
time of the page's main thread, scripts, layout and painting, from one animation frame to the next,
by the browser's own tracing; drawing pixels is done by other threads.
"""

import argparse
import contextlib
import json
import shutil
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

CATEGORIES = ["toplevel", "devtools.timeline"]
TASK, FRAME = "ThreadControllerImpl::RunTask", "FireAnimationFrame"
FRAME_COLUMNS = (
    "screen frames/s",
    "frame p50 ms",
    "frame p99 ms",
    "frame max ms",
    "longest gap ms",
)


class FrameWork(NamedTuple):
    """Frames a second, processor time of a frame, and the longest time between two of them."""

    rate_hz: float
    median_ms: float
    p99_ms: float
    most_ms: float
    gap_ms: float

    def cells(self) -> list[str]:
        """As in FRAME_COLUMNS."""
        return [f"{self.rate_hz:.0f}", *(f"{one:.1f}" for one in self[1:])]


class PageWatcher:
    """The page in a browser."""

    def __init__(self, browser: Any, address: str) -> None:
        self._browser = browser
        self.page = browser.new_page(viewport={"width": 1360, "height": 900})
        self.page.goto(address)
        self.page.wait_for_selector("#connection.there")
        self._session = self.page.context.new_cdp_session(self.page)
        self._session.send("Performance.enable")

    def usage(self) -> tuple[float, float]:
        """Seconds of script so far, and the heap in MB after its garbage was collected."""
        self._session.send("HeapProfiler.collectGarbage")
        listed = self._session.send("Performance.getMetrics")["metrics"]
        found = {one["name"]: one["value"] for one in listed}
        return found["ScriptDuration"], found["JSHeapUsedSize"] / 1e6

    def frames(self, seconds: float) -> FrameWork:
        """What the frames of the next so many seconds took."""
        self._browser.start_tracing(page=self.page, categories=CATEGORIES)
        self.page.wait_for_timeout(1e3 * seconds)
        return frame_work(json.loads(self._browser.stop_tracing())["traceEvents"])


def frame_work(events: list[dict[str, Any]]) -> FrameWork:
    """The work of each frame, from the trace events of the thread that draws frames."""
    frames = [one for one in events if one["name"] == FRAME and one["ph"] == "X"]
    thread = {(one["pid"], one["tid"]) for one in frames}
    assert len(thread) == 1, "one page draws at a time"
    tasks = [one for one in events if one["name"] == TASK and (one["pid"], one["tid"]) in thread]
    begins_us = np.sort([one["ts"] for one in frames])
    # A task belongs to the frame that began last before its end: it may be what began it.
    at = np.searchsorted(begins_us, [one["ts"] + one.get("dur", 0) for one in tasks]) - 1
    work_ms = np.zeros(len(begins_us) + 1)
    np.add.at(work_ms, at, [1e-3 * one.get("tdur", 0) for one in tasks])
    work_ms = work_ms[: len(begins_us) - 1]  # the last frame is incomplete, and [-1] precedes all
    gaps_ms = 1e-3 * np.diff(begins_us)
    return FrameWork(
        1e3 / float(gaps_ms.mean()), *np.percentile(work_ms, [50, 99, 100]), float(gaps_ms.max())
    )


@contextlib.contextmanager
def watched_page(address: str) -> Iterator[PageWatcher]:
    """Open the page for the length of the block."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--disable-gpu", "--enable-precise-memory-info"]
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=arguments
        )
        yield PageWatcher(browser, address)
        browser.close()


def main() -> None:
    """Watch a page that is already served."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("--seconds", type=float, default=30.0)
    args = parser.parse_args()
    with watched_page(args.address) as watcher:
        found = watcher.frames(args.seconds)
        for name, cell in zip(FRAME_COLUMNS, found.cells(), strict=True):
            print(f"{name}: {cell}")


if __name__ == "__main__":
    main()
