"""The campaign's page while it flies: written anew now and then, so that it can be watched."""

import time
from collections.abc import Callable
from pathlib import Path

from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.campaign.results.campaign_report import write_page

RELOAD_S = 5.0  # between two looks of the open page
WRITE_TIME_SHARE = 0.05  # of the time that writing may take


class LiveHeatMap:
    """`campaign.html` as results come in; an open one loads itself again.

    `clock` gives seconds that only grow.
    """

    def __init__(
        self, folder: Path, plan: CampaignPlan, clock: Callable[[], float] = time.monotonic
    ):
        self._folder, self._plan, self._clock = folder, plan, clock
        self._next_s = clock()

    def show(self, results: list[CellResult]) -> None:
        """Write the page if it is time; the ledger has these results already."""
        begin_s = self._clock()
        if begin_s < self._next_s or not results:
            return
        write_page(self._folder, self._plan, reload_s=RELOAD_S)
        took_s = self._clock() - begin_s
        # A page of many flights takes its time, which the flights are to have.
        self._next_s = self._clock() + max(RELOAD_S, took_s / WRITE_TIME_SHARE)
