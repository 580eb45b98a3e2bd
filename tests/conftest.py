"""What the tests share: real logs and GNSS data, a browser, and Hypothesis profiles."""

import os
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

DATA = Path(
    os.environ.get("MAVPROXY_FAULT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
)

settings.register_profile("fast", max_examples=40, deadline=None, derandomize=True)
settings.register_profile("deep", max_examples=5000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fast"))

# The longest files come first, so that at the end no worker waits for one of them.
LONGEST = (
    "test_quickstarts.py", "test_actuator_detector.py", "test_autopilot_run.py", "test_ci.py",
    "test_examples_fly.py", "test_page_watching.py", "test_detector.py", "test_notebook.py",
    "test_campaign_command.py", "test_kills.py", "test_report_browser.py", "test_page_sequence.py",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the files by how long they take."""
    place = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(LONGEST)))


@pytest.fixture(scope="session", autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The bus's password is made for the tests, not in the home of who runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.delenv("ZENOH_CONFIG", raising=False)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real logs; the test is skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no real logs at {DATA}; set MAVPROXY_FAULT_DATA")
    return DATA


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's Chromium without a window; one for all, Playwright runs only once in a process."""
    # The build without a window takes half the processor time.
    chromium = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    if chromium is None:
        pytest.skip("Debian's chromium is not installed")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    arguments = [
        "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--disable-background-networking", "--disable-component-update", "--no-first-run",
    ]  # fmt: skip
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=chromium, args=arguments)
        yield found
        found.close()


# Width in pixels and colours of a telephone, a tablet on its side, a desk: colours do not depend on
# the width, nor widths on colours.
SCREENS = ((390, "light"), (1024, "dark"), (1440, "light"))


@pytest.fixture(scope="session")
def find_barriers() -> Callable[..., list[str]]:
    """What axe-core finds on an open page, in light and dark, and where it scrolls sideways."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    playwright_timeout = pytest.importorskip("playwright.sync_api").TimeoutError

    def find(page: Any, screens: tuple[tuple[int, str], ...] = SCREENS) -> list[str]:
        found = []
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        for width_px, scheme in screens:
            page.emulate_media(color_scheme=scheme)
            page.set_viewport_size({"width": width_px, "height": 900})
            page.wait_for_timeout(200)  # the plots take the new width
            where = f"{scheme}, {width_px} px: "
            fits = "document.documentElement.scrollWidth <= innerWidth"
            try:
                page.wait_for_function(fits, timeout=10_000)  # on a busy machine it takes longer
            except playwright_timeout:
                found.append(where + "scrolls sideways")
            for one in axe.run(page).response["violations"]:
                found += [f"{where}{one['help']}: {node['html']}" for node in one["nodes"]]
        return found

    return find


@pytest.fixture(scope="session")
def install_package() -> Callable[[Path], None]:
    """Install a package of a folder that is then on the PYTHONPATH."""
    return leave_entry_points


def leave_entry_points(folder: Path) -> None:
    """Leave beside a package what an installer does: its entry points."""
    text = (folder / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    groups = [
        "\n".join([f"[{group}]", *(f"{name} = {value}" for name, value in points.items())])
        for group, points in project["entry-points"].items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))
