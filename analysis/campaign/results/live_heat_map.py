"""The page of a running campaign, rewritten from time to time."""

import time
from collections.abc import Callable
from pathlib import Path

from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.campaign.results.campaign_report import write_page

RELOAD_S = 5.0  # between two reloads of an open page
WRITE_TIME_SHARE = 0.05  # largest share of the time spent on writing the page


class LiveHeatMap:
    """Writes `campaign.html` as results come in; an open page reloads itself.

    `clock` returns monotonic seconds.
    """

    def __init__(
        self, folder: Path, plan: CampaignPlan, clock: Callable[[], float] = time.monotonic
    ):
        self._folder, self._plan, self._clock = folder, plan, clock
        self._next_s = clock()

    def show(self, results: list[CellResult]) -> None:
        """Write the page when due; the results store already has these results."""
        begin_s = self._clock()
        if begin_s < self._next_s or not results:
            return
        write_page(self._folder, self._plan, reload_s=RELOAD_S)
        took_s = self._clock() - begin_s
        # Writing a large page must not slow the flights down.
        self._next_s = self._clock() + max(RELOAD_S, took_s / WRITE_TIME_SHARE)
