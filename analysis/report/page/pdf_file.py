"""Print a report to PDF with an installed Chromium-based browser."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "msedge")
TIMEOUT_S = 180  # chosen, for a long report on a slow computer


def write_pdf(page: Path) -> Path:
    """Print `report.html` to `report.pdf` beside it.

    Raises
    ------
    ConfigError
        If no browser is installed or printing fails.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise ConfigError(f"--pdf: no browser found; install one of {', '.join(BROWSERS)}")
    target = page.with_suffix(".pdf")
    # Remove an old file, so that a failure is noticed.
    target.unlink(missing_ok=True)
    # Chromium cannot run sandboxed as root; the page runs no foreign script (see its policy).
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    # A separate profile: a running browser with the user's profile would take over the command.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # The virtual time (ms) lets the scripts draw before printing.
        command = [
            browser, "--headless", "--disable-gpu", "--no-first-run", *sandbox,
            "--disable-background-networking", f"--user-data-dir={profile}",
            "--virtual-time-budget=30000", "--no-pdf-header-footer",
            f"--print-to-pdf={target}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            subprocess.run(command, capture_output=True, timeout=TIMEOUT_S, check=True)
        except (subprocess.SubprocessError, OSError) as error:
            raise ConfigError(f"--pdf: {browser} failed ({error}); try another browser") from error
    if not target.is_file():
        raise ConfigError(f"--pdf: {browser} wrote no file; try another browser")
    return target
