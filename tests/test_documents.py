"""The documents point at what is there."""

import re
import runpy
import shlex
import textwrap
from pathlib import Path

import pytest
import yaml

from mavproxy_fault.app.command_parser import CommandParser
from mavproxy_fault.cli import build_parser
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
