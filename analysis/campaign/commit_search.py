"""`campaign bisect`: find the commit since which a campaign fails, with git's own bisection.

For each commit that git chooses, the autopilot is built and the campaign flown. A commit whose
build fails, or whose flights only abort, is skipped.
"""

import argparse
import os
import subprocess
from pathlib import Path

import msgspec

from analysis.campaign.campaign_file import CampaignFile, SubjectChoice, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.campaign_run import run_campaign
from analysis.campaign.outcomes import ABORTED
from analysis.campaign.results.campaign_comparison import compare_folders
from analysis.campaign.results_store import read_campaign_folder
from mavproxy_fault.documents.errors import ConfigError

FOUND = "is the first bad commit"  # as `git bisect` says


def bisect_commits(file: str, good: str, bad: str, args: argparse.Namespace) -> int:
    """Bisect the repository of the current folder; print the commit and what got worse with it.

    Raises
    ------
    ConfigError
        If git refuses, or the campaign has no autopilot.
    """
    campaign = with_binary(read_campaign(file), Path(args.binary).absolute())
    out = Path(args.out or f"runs/bisect-{campaign.name}").absolute()
    run_git("bisect", "start", bad, good, "--")
    said, builds = "", 0
    try:
        while FOUND not in said:
            commit = run_git("rev-parse", "HEAD")
            builds += 1
            word = judge_commit(campaign, out / commit, args)
            print(f"build {builds}: {commit[:12]} is {word}", flush=True)
            said = run_git("bisect", word)
    finally:
        run_git("bisect", "reset")
    first_bad = said.partition(f" {FOUND}")[0].split()[-1]
    print(f"{builds} builds; first bad commit: {run_git('log', '-1', '--oneline', first_bad)}")
    before = out / run_git("rev-parse", f"{first_bad}^")
    # GOOD itself is not flown.
    if before.is_dir():
        compare_folders(before, out / first_bad, args)
    return 0


def with_binary(campaign: CampaignFile, binary: Path) -> CampaignFile:
    """Return the campaign with this program for its autopilots.

    Raises
    ------
    ConfigError
        If it has none.
    """
    subjects = tuple(
        msgspec.structs.replace(one, binary=str(binary)) if isinstance(one, SubjectChoice) else one
        for one in campaign.subjects
    )
    if subjects == campaign.subjects:
        raise ConfigError("campaign bisect: needs a campaign with an autopilot among its subjects")
    return msgspec.structs.replace(campaign, subjects=subjects)


def judge_commit(campaign: CampaignFile, folder: Path, args: argparse.Namespace) -> str:
    """Build the commit that is checked out, and fly it; return the word for `git bisect`."""
    if subprocess.run(args.build, shell=True, check=False).returncode:
        return "skip"
    try:
        run_campaign(CampaignPlan(campaign), folder, args.workers or os.cpu_count() or 1, args)
    except ConfigError as error:
        # A program that cannot fly even the reference flight says nothing about the change.
        print(error, flush=True)
        return "skip"
    _, results = read_campaign_folder(folder)
    flown = [result for result in results if result.outcome != ABORTED]
    if any(map(campaign.fails, flown)):
        return "bad"
    return "good" if len(flown) == len(results) else "skip"


def run_git(*words: str) -> str:
    """Run git in the current folder; return what it printed.

    Raises
    ------
    ConfigError
        If it fails.
    """
    done = subprocess.run(["git", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(f"git {' '.join(words)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip()
