"""`mavproxy-fault campaign`: fly test cells, compare two campaigns, or search around a cell."""

import argparse
import os
from pathlib import Path

from analysis.campaign.campaign_file import CampaignFile, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.campaign_run import CampaignRun
from analysis.campaign.cell import CellResult
from analysis.campaign.results.campaign_progress import CampaignProgress
from analysis.campaign.results.campaign_report import write_report
from analysis.campaign.results.live_heat_map import LiveHeatMap
from analysis.campaign.results.outcome_table import print_outcomes
from analysis.campaign.results_store import ResultsStore
from analysis.campaign.worker_pool import open_worker_pool
from mavproxy_fault.documents.errors import ConfigError

# Rough values: an estimate in minutes, hours or days.
SIMULATOR_SPEED = 15.0  # simulated seconds per second of one worker
LANE_SPEED = 20_000.0
# With start, take-off and landing: 26 s under PX4 took 13 s, under ArduCopter 27 s.
AUTOPILOT_SPEED = 1.0


def main(args: argparse.Namespace) -> int:
    """Fly a campaign, compare two, or write a search around a cell; return the exit code."""
    if args.file[0] == "compare":
        from analysis.campaign.results.campaign_comparison import compare_folders

        if len(args.file) != 3:
            raise ConfigError("campaign compare: needs two campaign folders, BEFORE and AFTER")
        return compare_folders(*(Path(name) for name in args.file[1:]))
    if args.file[0] == "search":
        from analysis.campaign.results.cell_search import write_search

        if len(args.file) not in (2, 3):
            raise ConfigError(
                "campaign search: needs a campaign folder and optionally a cell's key"
            )
        path = write_search(Path(args.file[1]), args.file[2] if len(args.file) == 3 else None)
        print(f"mavproxy-fault search {path}")
        return 0
    if len(args.file) != 1:
        raise ConfigError("campaign: needs exactly one campaign file; see docs/campaigns.md")
    campaign = read_campaign(args.file[0])
    check_binaries(campaign)
    workers = args.workers or os.cpu_count() or 1
    folder = Path(args.out) if args.out else new_folder(Path("runs"), campaign.name)
    keep = folder / "flights" if args.dataset or campaign.keep != "none" else None
    plan = CampaignPlan(campaign, keep)
    # With `--dry-run` this is the complete output.
    print(describe_size(plan, workers), flush=True)
    if args.dry_run:
        return 0
    failed = run_campaign(plan, folder, workers, args.ray)
    if args.dataset:
        from analysis.campaign.results.data_set import export_data_set

        export_data_set(folder, Path(args.dataset))
    return int(failed > 0)


def check_binaries(campaign: CampaignFile) -> None:
    """Look for the autopilots' programs, before every flight fails for want of them.

    Raises
    ------
    ConfigError
        If a program does not exist.
    """
    subjects = [s for s in campaign.subjects if not isinstance(s, str)]
    if not subjects:
        return
    # Imported here: without an autopilot its modules are not needed.
    from analysis.autopilots.autopilot_run import AUTOPILOTS

    for subject in subjects:
        try:
            AUTOPILOTS[subject.autopilot.partition(":")[0]].launch_command(subject.binary)
        except ConfigError as error:
            text = str(error).removeprefix("--binary: ")
            raise ConfigError(f"{campaign.name}: subject {subject.name}: binary {text}") from None


def run_campaign(plan: CampaignPlan, folder: Path, workers: int, ray_address: str | None) -> int:
    """Fly the missing cells, then write and print the results, also after Ctrl-C.

    Returns
    -------
    int
        The number of cells that failed.
    """
    campaign = plan.campaign
    store = ResultsStore(folder, campaign)
    pool = open_worker_pool(workers, ray_address, campaign.flight_limit_s)
    try:
        with CampaignProgress(plan.max_cells, len(store.results)) as progress:
            heat_map = LiveHeatMap(folder, plan)

            def show(results: list[CellResult]) -> None:
                progress.show(results)
                heat_map.show(results)

            CampaignRun(plan, pool, store, show).run_all()
    finally:
        pool.close()
        store.close()
        # There may be no results if the first flight was refused.
        if store.results:
            write_report(folder, plan)
            print_outcomes(folder, plan)
    return sum(campaign.fails(result) for result in store.results.values())


def new_folder(parent: Path, name: str) -> Path:
    """Return `campaign-NAME-N` with the first free number."""
    number = 1
    while (parent / f"campaign-{name}-{number}").exists():
        number += 1
    return parent / f"campaign-{name}-{number}"


def describe_size(plan: CampaignPlan, workers: int) -> str:
    """Describe the number of cells and flights, and the expected duration."""
    campaign: CampaignFile = plan.campaign
    # Reference flights are flights, but not cells.
    flights, cells = plan.max_flights + len(plan.reference_jobs()), plan.max_cells
    speed = LANE_SPEED if campaign.compiled else SIMULATOR_SPEED
    if any(map(campaign.autopilot, campaign.subject_names)):
        speed = AUTOPILOT_SPEED
    wall_s = flights * plan.flight_s / speed / workers
    most = "at most " if campaign.find == "critical" else ""
    return (
        f"{campaign.name}: {most}{cells} cells in {flights} flights of {plan.flight_s:g} s, "
        f"about {format_duration(wall_s)} on {workers} workers"
    )


def format_duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 90.0:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
