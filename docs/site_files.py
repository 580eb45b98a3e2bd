"""What the site has beside docs/: the measurements, the files to copy and a list of those.

A hook of mkdocs. Pages of docs/ link to `../benchmarks` and `../examples`, as they have to in a
repository; in the site both folders lie beside the pages.
"""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
LIST = "files.md"
# Of a YAML file the comment at its beginning, of Python the docstring.
ABOUT = re.compile(r'\A(?:#|""")((?:[^\n"]|\n# )*)')
TITLES = {  # of files without a comment at their beginning
    "examples/estimator.ipynb": "A notebook: an estimator of your own, from sweep to search.",
    "examples/pytest/pytest.ini": "The settings of the tests beside it.",
    "examples/views/foxglove.json": "A layout for Foxglove: map, 3D, plots, log.",
    "examples/views/plotjuggler.xml": "A layout for PlotJuggler.",
}


def on_files(files: Files, config: Any) -> Files:
    """Add the files of both folders, and the list of those to copy."""
    rows = []
    for path in sorted((ROOT / "benchmarks").glob("*.md")) + sorted((ROOT / "examples").rglob("*")):
        name = path.relative_to(ROOT).as_posix()
        if path.is_dir() or "__pycache__" in name:
            continue
        files.append(File.generated(config, name, abs_src_path=str(path)))
        if name.startswith("examples/"):
            title = TITLES[name] if name in TITLES else first_sentence(path)
            rows.append(f"| [{name}]({name}) | {title} |")
    head = "# Files to copy\n\n| file | what it is |\n|---|---|\n"
    files.append(File.generated(config, LIST, content=head + "\n".join(rows)))
    return files


def first_sentence(path: Path) -> str:
    """The first sentence of what a file says of itself."""
    found = ABOUT.match(path.read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"{path}: begins without a comment; add one, or a line to TITLES")
    text = " ".join(found[1].replace("\n# ", " ").split())
    return re.split(r"(?<=[.?]) (?=[A-Z]|mavproxy-fault|python)", text)[0].replace("|", "\\|")


def titles_of(nav: list[Any]) -> dict[str, str]:
    """The title of each page that has one in the navigation."""
    found: dict[str, str] = {}
    for entry in nav:
        for title, value in entry.items() if isinstance(entry, dict) else ():
            found |= {value: title} if isinstance(value, str) else titles_of(value)
    return found


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Turn links between the three folders into links within the site, named by page, not file."""
    titles = titles_of(config["nav"])
    markdown = re.sub(
        r"\[(\w+\.md)\](?=\(\1)", lambda link: f"[{titles.get(link[1], link[1])}]", markdown
    )
    if page.file.src_uri.startswith("benchmarks/"):
        return markdown.replace("](../docs/", "](../")
    # A folder is its place in the list.
    folders = re.compile(r"\]\(\.\./examples/\w+\)")
    return re.sub(r"\]\(\.\./(benchmarks|examples)/", r"](\1/", folders.sub(f"]({LIST})", markdown))
