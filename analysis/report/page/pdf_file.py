"""A report as PDF, printed by a browser of the Chromium family where one is installed."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "msedge")
TIMEOUT_S = 180  # that a browser may need


def write_pdf(page: Path) -> Path:
    """Print `report.html` to `report.pdf` beside it.

    Raises
    ------
    ConfigError
        If there is no browser, or it does not print.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise ConfigError(f"--pdf: no browser found; install one of {', '.join(BROWSERS)}")
    target = page.with_suffix(".pdf")
    # An old file must not pass for the new one.
    target.unlink(missing_ok=True)
    # A browser of root's refuses its sandbox; the page holds no foreign script (see its policy).
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    # A profile of its own: a browser that already runs with the user's would take the command over.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # The budget is in milliseconds of the page's time: its scripts draw before it is printed.
        command = [
            browser, "--headless", "--disable-gpu", "--no-first-run", *sandbox,
            "--disable-background-networking", f"--user-data-dir={profile}",
            "--virtual-time-budget=30000", "--no-pdf-header-footer",
            f"--print-to-pdf={target}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            subprocess.run(command, capture_output=True, timeout=TIMEOUT_S, check=True)
        except (subprocess.SubprocessError, OSError) as error:
            raise ConfigError(f"--pdf: {browser} did not print ({error}); try another") from error
    if not target.is_file():
        raise ConfigError(f"--pdf: {browser} wrote no file; try another browser")
    return target
