"""The documents point at what is there."""

import glob
import re
import runpy
import shlex
import shutil
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from mavproxy_fault.app.command_parser import CommandParser
from mavproxy_fault.cli import build_parser, main
from mavproxy_fault.documents.yaml_document import read_yaml

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    file
    for folder in (ROOT, ROOT / "docs", ROOT / "benchmarks", ROOT / "examples")
    for file in (folder.glob("*.md") if folder == ROOT else folder.rglob("*.md"))
)
LINK = re.compile(r"\]\((?![a-z]+:|#)([^)\s#]+)")  # neither https: nor a place on the same page


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_every_link_leads_to_a_file(document: Path) -> None:
    targets = LINK.findall(document.read_text(encoding="utf-8"))
    assert [target for target in targets if not (document.parent / target).exists()] == []


HEADER = re.compile(r"^\|(.*)\|\n\|[-:| ]+\|$", re.M)  # of a table


def test_every_column_of_a_table_has_a_name() -> None:
    """A screen reader reads it before each cell."""
    unnamed = [
        f"{document.name}: {header}"
        for document in DOCUMENTS
        for header in HEADER.findall(document.read_text(encoding="utf-8"))
        if any(not cell.strip() for cell in header.split("|"))
    ]
    assert unnamed == []


def pages_of(navigation: list[dict[str, object] | str]) -> list[str]:
    """The pages of a navigation of mkdocs, in order."""
    found: list[str] = []
    for title in navigation:
        for value in [title] if isinstance(title, str) else title.values():
            found += [value] if isinstance(value, str) else pages_of(value)  # type: ignore[arg-type]
    return found


def test_the_site_begins_with_a_first_page_and_leads_to_every_other() -> None:
    navigation = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    assert [next(iter(title)) for title in navigation] == [
        "Start", "Ten minutes", "How to", "Reference", "Explanation", "Measurements",
    ]  # fmt: skip
    pages = pages_of(navigation)
    # mkdocs makes the site's index.html of this page.
    assert pages[0] == "index.md"
    measurements = [f"benchmarks/{page.name}" for page in (ROOT / "benchmarks").glob("*.md")]
    # The list of files to copy is written by docs/site_files.py.
    written = ["files.md", *measurements, *(page.name for page in (ROOT / "docs").glob("*.md"))]
    assert sorted(pages) == sorted(written)
    text = (ROOT / "docs" / "index.md").read_text()
    for who in ("PX4", "ArduPilot", "research", "study"):
        assert who in text


def test_the_reference_is_that_of_the_sources() -> None:
    page = runpy.run_path(str(ROOT / "docs" / "write_reference.py"))
    assert page["FILE"].read_text(encoding="utf-8") == page["reference"]()


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Blocks: fenced, or indented by four after an empty line.
FENCED = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.S | re.M)
INDENTED = re.compile(r"(?:\A|\n)\n((?:    [^\n]*\n|\n)+)")
# Programs whose commands only the reader can run, and why.
NOT_OURS = {
    "podman": "needs a container's base image",
    "java": "another simulator",
    "PX4_SIM_MODEL": "PX4 by itself",
    "build/px4_sitl_default": "PX4 by itself",
    "./waf": "builds ArduPilot",
    "git": "a repository of the reader's",
    "mavproxy.py": "run by the quickstarts",
    "cp": "run by the quickstarts",
}
COMMAND = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?mavproxy-fault (.*)$", re.M)


def blocks_of(page: Path) -> list[tuple[str, str]]:
    """The language and text of every block of a page."""
    text = page.read_text(encoding="utf-8")
    rest = FENCED.sub("", text)
    indented = [("", textwrap.dedent(block)) for block in INDENTED.findall(rest)]
    return [*FENCED.findall(text), *indented]


def commands_of(page: Path) -> list[str]:
    """Our commands in the blocks of a page, without comments and what the shell does."""
    joined = (text.replace("\\\n", " ") for _, text in blocks_of(page))
    return [
        re.split(r"  +#|\s[|&>;]", line)[0].removesuffix(" &")
        for text in joined
        for line in COMMAND.findall(text)
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_printed_command_is_one_that_the_command_line_takes(page: Path) -> None:
    # The quickstarts are run by test_quickstarts.py; what others print is at least parsed.
    for command in commands_of(page):
        words = [word for word in shlex.split(command) if word not in ("[...]", "...")]
        if "..." in command or words[:1] == ["--completion"]:
            continue
        words = [word.strip("[]").split("|")[0] for word in words]
        if "--dialect" in words:  # of every command, taken before the others
            del words[words.index("--dialect") : words.index("--dialect") + 2]
        parser = build_parser(words[0])
        assert isinstance(parser, CommandParser)
        parser.parse_args(words)
        for word in words:
            if word.startswith("examples/"):
                assert (ROOT / word).exists(), command


# The commands of indented blocks that are not run here, and why.
NOT_RUN = {
    r"--autopilot|autopilot_search|autopilots-1|--binary|(px4|copter)\.yaml": "needs an autopilot",
    r"^(sim|proxy|ardupilot|ui|inject) |^ui$|--ui|--link|--zenoh|--interactive": "runs beside"
    " another program, as in the quickstarts, or shows a page until Ctrl-C",
    r"--rinex|rover\.obs|\.ulg": "needs a recording of the reader's",
    r"estimators-1|monitor-1|campaign_compiled": "takes minutes",
    r"campaign_estimators.yaml($| --out)|search .*_search.yaml$": "takes minutes",
    r"examples/fusion.yaml$": "flown by tests/analysis/run/test_examples_fly.py",
    r"worst-01-campaign|--first$": "flies a search of the reader's, as tests/analysis/search does",
}
INDENTED_COMMAND = re.compile(r"^(mavproxy-fault|cp) (.*)$", re.M)
SHORT = ROOT / "tests" / "analysis" / "campaign" / "short.yaml"
FAULT = "{id: f, fault: bias, target: HIL_SENSOR.xgyro, at_s: 2, for_s: 2, value: 1}"
CAMPAIGN = """
name: a reader's
subjects: [ekf]
scenarios: [../flight.yaml]
onsets: [2]
durations_s: [2]
faults: [{id: gyro, fault: bias, target: HIL_SENSOR.xgyro, magnitudes: [0.1]}]
"""


def indented_commands(page: Path) -> Iterator[tuple[str, str]]:
    """Program and arguments of the commands of indented blocks, without comments."""
    rest = FENCED.sub("", page.read_text(encoding="utf-8"))
    for block in INDENTED.findall(rest):
        text = textwrap.dedent(block).replace("\\\n", " ")
        for program, line in INDENTED_COMMAND.findall(text):
            yield program, re.split(r"  +#| \|\| ", line)[0].rstrip()


def reason_not_to_run(line: str) -> str | None:
    return next((NOT_RUN[one] for one in NOT_RUN if re.search(one, line)), None)


WITH_COMMANDS = [
    page
    for page in PAGES
    if any(reason_not_to_run(line) is None for _, line in indented_commands(page))
]


@pytest.fixture(scope="module")
def readers_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the pages' commands are about: flights, their logs, and campaigns."""
    folder = tmp_path_factory.mktemp("reader")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("examples").symlink_to(ROOT / "examples")
        Path("flight.yaml").write_text(f"{SHORT.read_text()}schedule: {{faults: [{FAULT}]}}\n")
        Path("tests").mkdir()
        Path("tests/campaign.yaml").write_text(CAMPAIGN)
        assert main(["run", "flight.yaml", "--zenoh", "off", "--out", "runs/0001-demo"]) in (0, 1)
        assert main(["campaign", "tests/campaign.yaml", "--out", "before"]) in (0, 1)
        for copy in ("after", "runs/campaign-px4-1"):
            shutil.copytree("before", copy)
        shutil.copytree("runs/0001-demo", "runs/a")
        shutil.copy("runs/a/labels.jsonl", ".")
        Path("logs").mkdir()
        for name in ("flight", "hil", "gcs", "new", "old", "logs/1", "logs/2"):
            shutil.copy("runs/a/sent.tlog", f"{name}.tlog")
    return folder


@pytest.mark.timeout(600)  # a search and some flights
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.stem)
def test_the_indented_commands_of_a_page_run_as_printed(
    page: Path, readers_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(readers_folder, tmp_path / "here", symlinks=True)
    monkeypatch.chdir(tmp_path / "here")
    for program, line in indented_commands(page):
        if reason_not_to_run(line) is not None:
            continue
        words = [file for word in shlex.split(line) for file in sorted(glob.glob(word)) or [word]]
        if program == "cp":
            shutil.copy(*words)
        else:
            assert main(words) in (0, 1), line  # 1: a verdict, or something got worse


def test_every_reason_not_to_run_a_command_holds_for_one() -> None:
    lines = [line for page in PAGES for _, line in indented_commands(page)]
    assert [one for one in NOT_RUN if not any(re.search(one, line) for line in lines)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_fenced_block_of_yaml_is_yaml(page: Path) -> None:
    for language, text in blocks_of(page):
        if language in ("yaml", "yml"):
            read_yaml(text, page.name)


def test_every_program_of_a_fenced_block_is_run_or_has_a_reason() -> None:
    run = {"mavproxy-fault", ".venv/bin/mavproxy-fault", "python", "pip", "pytest", "python3"}
    run |= {"kill"}  # of what a block started
    for page in PAGES:
        for language, text in blocks_of(page):
            if language in ("bash", "console"):
                for line in text.splitlines():
                    program = line.removeprefix("$ ").split(" ")[0]
                    if language == "console" and not line.startswith("$ "):
                        continue
                    assert program in run or program in NOT_OURS, (page.name, line)
