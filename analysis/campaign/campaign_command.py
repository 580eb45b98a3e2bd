"""`mavproxy-fault campaign`: fly test cells, compare campaigns, bisect, or search around a cell."""

import argparse
import os
import sys
from pathlib import Path
from typing import NamedTuple

from analysis.campaign.campaign_file import CampaignFile, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.campaign_run import run_campaign
from analysis.report.run_folder import numbered_folder
from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError

# Rough values: an estimate in minutes, hours or days.
SIMULATOR_SPEED = 15.0  # simulated seconds per second of one worker
COMPILED_SPEED = 7_000.0
# With start, take-off and landing: 26 s under PX4 took 13 s, under ArduCopter 27 s.
AUTOPILOT_SPEED = 1.0


def main(args: argparse.Namespace) -> int:
    """Fly a campaign, compare two, bisect commits, or write a search around a cell; return the exit
    code."""
    if args.file[0] == "compare":
        from analysis.campaign.results.campaign_comparison import compare_folders

        if len(args.file) != 3:
            raise ConfigError("campaign compare: needs two campaign folders, BEFORE and AFTER")
        return compare_folders(Path(args.file[1]), Path(args.file[2]), args)
    if args.file[0] == "bisect":
        from analysis.campaign.commit_search import bisect_commits

        if len(args.file) != 4 or not (args.build and args.binary):
            raise ConfigError("campaign bisect: needs FILE GOOD BAD, --build CMD and --binary PATH")
        return bisect_commits(args.file[1], args.file[2], args.file[3], args)
    if args.file[0] == "search":
        from analysis.campaign.results.cell_search import write_search

        if len(args.file) not in (2, 3):
            raise ConfigError(
                "campaign search: needs a campaign folder and optionally a cell's key"
            )
        path = write_search(Path(args.file[1]), args.file[2] if len(args.file) == 3 else None)
        print_result(args, {"test_file": path}, f"mavproxy-fault search {path}")
        return 0
    if len(args.file) != 1:
        raise ConfigError("campaign: needs exactly one campaign file; see docs/campaigns.md")
    campaign = read_campaign(args.file[0])
    check_binaries(campaign)
    workers = args.workers or os.cpu_count() or 1
    folder = Path(args.out) if args.out else numbered_folder(f"campaign-{campaign.name}")
    keep = folder / "flights" if args.dataset or campaign.keep != "none" else None
    plan = CampaignPlan(campaign, keep, args.sample)
    size = estimate_size(plan, workers)
    if args.dry_run:
        print_result(args, size._asdict(), describe_size(size))
        return 0
    print(describe_size(size), file=sys.stderr, flush=True)
    failed = run_campaign(plan, folder, workers, args)
    if args.dataset:
        from analysis.campaign.results.data_set import export_data_set

        export_data_set(folder, Path(args.dataset))
    if args.evidence:
        from analysis.campaign.results.evidence import write_evidence

        write_evidence(folder, Path(args.evidence))
        print(f"evidence {Path(args.evidence) / 'evidence.html'}", file=sys.stderr)
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


class CampaignSize(NamedTuple):
    """The size of a campaign; of a search for critical magnitudes, the largest possible."""

    name: str
    cells: int
    flights: int
    flight_s: float
    duration_s: float
    workers: int
    is_exact: bool


def estimate_size(plan: CampaignPlan, workers: int) -> CampaignSize:
    """Count cells and flights, and estimate the duration."""
    campaign: CampaignFile = plan.campaign
    # Reference flights are flights, but not cells.
    flights, cells = plan.max_flights + len(plan.reference_jobs()), plan.max_cells
    speed = COMPILED_SPEED if campaign.compiled else SIMULATOR_SPEED
    if any(map(campaign.autopilot, campaign.subject_names)):
        speed = AUTOPILOT_SPEED
    wall_s = flights * plan.flight_s / speed / workers
    exact = campaign.find != "critical"
    return CampaignSize(campaign.name, cells, flights, plan.flight_s, wall_s, workers, exact)


def describe_size(size: CampaignSize) -> str:
    """Describe the size in a sentence."""
    most = "" if size.is_exact else "at most "
    return (
        f"{size.name}: {most}{size.cells} cells in {size.flights} flights of {size.flight_s:g} s, "
        f"about {format_duration(size.duration_s)} on {size.workers} free processors"
    )


def format_duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 90.0:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
