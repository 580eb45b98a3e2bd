"""`campaign bisect`: a planted commit among 64 is found in a few builds."""

import subprocess
from pathlib import Path

import msgspec
import pytest

from analysis.campaign import commit_search
from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.cell import Cell, CellResult
from analysis.campaign.results_store import ResultsStore
from mavproxy_fault import cli
from mavproxy_fault.documents.errors import ConfigError

COMMITS, PLANTED, BROKEN_BUILD = 64, 41, 48
CAMPAIGN = """
name: toy
subjects: [{name: mine, autopilot: px4, binary: none}]
scenarios: [flight.yaml]
faults: [{id: jump, fault: bias, target: HIL_GPS.lat, magnitudes: [3000]}]
"""


def git(folder: Path, *words: str) -> str:
    base = ["git", "-C", str(folder), "-c", "user.name=x", "-c", "user.email=x@example.org"]
    done = subprocess.run([*base, *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Commits whose file holds their number; the program is a copy of it."""
    folder = tmp_path / "autopilot"
    folder.mkdir()
    (tmp_path / "toy.yaml").write_text(CAMPAIGN)
    git(folder, "init", "-q")
    (folder / ".gitignore").write_text("program\n")
    for number in range(COMMITS):
        (folder / "number").write_text(f"{number}\n")
        git(folder, "add", "-A")
        git(folder, "commit", "-q", "-m", f"commit {number}")
    monkeypatch.chdir(folder)
    return folder


def fly_program(plan, folder, workers, args) -> int:
    """In place of flights: programs from the planted commit on crash."""
    subject = plan.campaign.autopilot("mine")
    number = int(Path(subject.binary).read_text())
    outcome = "crashed" if number >= PLANTED else "unaffected"
    cells = [Cell(subject="mine", scenario="flight.yaml", fault="jump", seed=i) for i in range(6)]
    store = ResultsStore(folder, plan.campaign)
    store.add([CellResult(cell=cell, outcome=outcome) for cell in cells], None)
    store.close()
    return 0


def bisect(out: Path, build: str) -> int:
    words = ["campaign", "bisect", "../toy.yaml", "HEAD~63", "HEAD", "--build", build]
    return cli.main([*words, "--binary", "program", "--out", str(out)])


@pytest.mark.parametrize(
    "build", ["cp number program", f"! grep -qx {BROKEN_BUILD} number && cp number program"]
)
def test_a_planted_commit_among_64_is_found_in_at_most_seven_builds(
    repository: Path, build: str, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(commit_search, "run_campaign", fly_program)
    head = git(repository, "rev-parse", "HEAD")
    assert bisect(repository.parent / "out", build) == 0
    text = capsys.readouterr().out
    assert f"commit {PLANTED}" in text
    assert int(text.rpartition(" builds;")[0].split()[-1]) <= 7
    assert "1 of 1 got worse" in text  # the planted commit compared with the one before
    assert git(repository, "rev-parse", "HEAD") == head


def test_what_git_refuses_is_reported(repository: Path, monkeypatch) -> None:
    monkeypatch.setattr(commit_search, "run_campaign", fly_program)
    with pytest.raises(ConfigError, match="git bisect start"):
        commit_search.run_git("bisect", "start", "HEAD", "no-such-commit", "--")
    campaign = msgspec.structs.replace(read_campaign("../toy.yaml"), subjects=("ekf",))
    with pytest.raises(ConfigError, match="with an autopilot"):
        commit_search.with_binary(campaign, Path("program"))
