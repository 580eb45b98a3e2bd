"""The page of a running campaign."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results.campaign_report import write_page, write_report
from analysis.campaign.results.live_heat_map import RELOAD_S, LiveHeatMap
from analysis.campaign.results_store import ResultsStore
from analysis.flying.flight_evidence import ATTITUDE, CampaignFlight, Evidence, EvidenceCurve

SMALL = Path(__file__).parents[1] / "small.yaml"


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def plan_of() -> CampaignPlan:
    return CampaignPlan(read_campaign(SMALL))


def result(subject: str, magnitude: float, outcome: str) -> CellResult:
    cell = Cell(
        subject=subject, scenario="short.yaml", fault="gyro", magnitude=magnitude, onset=2.0,
        duration_s=2.0, seed=1,
    )  # fmt: skip
    return CellResult(cell=cell, outcome=outcome)


def test_the_page_of_a_running_campaign_is_rewritten_but_not_for_every_result(
    tmp_path: Path,
) -> None:
    plan, clock, page = plan_of(), Clock(), tmp_path / "campaign.html"
    store = ResultsStore(tmp_path, plan.campaign)
    heat_map = LiveHeatMap(tmp_path, plan, clock)

    def fly(subject: str) -> str:
        results = [result(subject, 2.0, "degraded")]
        store.add(results, None)
        heat_map.show(results)
        return page.read_text()

    assert "1 of 4 cells completed" in fly("ekf")
    assert "1 of 4 cells completed" in fly("mahony")
    clock.now_s += RELOAD_S
    assert "2 of 4 cells completed" in fly("mahony")
    write_report(tmp_path, plan)
    assert "cells completed" not in page.read_text()  # it is completed
    store.close()


@pytest.mark.browser
def test_an_open_heat_map_refreshes_and_keeps_the_selected_cell(
    tmp_path: Path, browser: Any
) -> None:
    plan = plan_of()
    store = ResultsStore(tmp_path, plan.campaign)
    store.add([result("ekf", 0.001, "unaffected"), result("ekf", 2.0, "degraded")], None)
    write_page(tmp_path, plan, reload_s=0.2)
    shown = browser.new_page()
    shown.goto((tmp_path / "campaign.html").as_uri())
    # The page may reload at any time: each access finds its element again, and the click goes to
    # the cell, not to its place on the screen.
    shown.locator(".heat td", has_text="2").dispatch_event("click")
    shown.wait_for_selector(".heat td.chosen:has-text('2')")
    store.add([result("mahony", 2.0, "lost")], None)
    write_page(tmp_path, plan)  # the final page, which does not reload
    shown.wait_for_selector("section:has-text('mahony') td:has-text('lost')")
    shown.wait_for_selector(".heat td.chosen:has-text('2 rad/sdegraded')")
    shown.close()
    store.close()


@pytest.mark.browser
def test_a_campaigns_page_is_for_all_and_fits_a_window_that_becomes_narrow(
    tmp_path: Path, browser: Any, find_barriers: Callable[[Any], list[str]]
) -> None:
    plan = plan_of()
    store = ResultsStore(tmp_path, plan.campaign)
    evidence = {"ekf": Evidence({ATTITUDE: EvidenceCurve([0.0, 1.0], [0.0, 2.0])})}
    store.add([result("ekf", 2.0, "degraded")], CampaignFlight(evidence))
    write_page(tmp_path, plan)
    shown = browser.new_page(viewport={"width": 1300, "height": 900})
    shown.goto((tmp_path / "campaign.html").as_uri())
    shown.wait_for_selector(".uplot")
    for width in (1024, 390):
        shown.set_viewport_size({"width": width, "height": 900})
        shown.wait_for_function(
            "() => document.documentElement.scrollWidth <= innerWidth"
            " && document.querySelector('.uplot').offsetWidth <= innerWidth"
        )
    assert find_barriers(shown) == []
    shown.close()
    store.close()
