"""The documentation as a site, as readers see it.

pip install mkdocs-material 'mkdocstrings[python]'; pytest tests/test_site.py

Without mkdocs, which the rest of the development does not need, the tests are skipped.
"""

import functools
import http.server
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    "", "files/",
    *(f"{page.stem}/" for page in sorted((ROOT / "docs").glob("*.md")) if page.stem != "index"),
    *(f"benchmarks/{page.stem}/" for page in sorted((ROOT / "benchmarks").glob("*.md"))),
]  # fmt: skip
SCREENS = ((390, "dark"), (1280, "light"))  # a telephone, a desk


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves files without a line on the terminal for each."""

    def log_message(self, *_: object) -> None:
        """Write nothing."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site: every link within it and every name of its reference resolves."""
    pytest.importorskip("material", reason="mkdocs-material is not installed")
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        build, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """The address of the site on loopback."""
    handler = functools.partial(QuietHandler, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_no_page_shows_a_block_of_code_as_text(site: Path) -> None:
    shown = [page for page in site.rglob("*.html") if "<p>```" in page.read_text(encoding="utf-8")]
    assert shown == []


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_without_barriers_on_a_telephone_and_a_desk(
    name: str, address: str, browser: Any, find_barriers: Callable[..., list[str]]
) -> None:
    page = browser.new_page()
    page.goto(f"{address}{name}")
    found = find_barriers(page, SCREENS)
    page.close()
    assert found == []
