"""The documents point at what is there."""

import re
from pathlib import Path

import pytest
import yaml

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


def pages_of(navigation: list[dict[str, object]]) -> list[str]:
    """The pages of a navigation of mkdocs, in order."""
    found: list[str] = []
    for title in navigation:
        for value in title.values():
            found += [value] if isinstance(value, str) else pages_of(value)  # type: ignore[arg-type]
    return found


def test_the_site_begins_with_a_first_page_and_leads_to_every_other() -> None:
    navigation = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    assert [next(iter(title)) for title in navigation] == [
        "Start", "How to", "Reference", "Explanation",
    ]  # fmt: skip
    pages = pages_of(navigation)
    # mkdocs makes the site's index.html of this page.
    assert pages[0] == "index.md"
    assert sorted(pages) == sorted(page.name for page in (ROOT / "docs").glob("*.md"))
    text = (ROOT / "docs" / "index.md").read_text()
    for who in ("PX4", "ArduPilot", "research", "study"):
        assert who in text
