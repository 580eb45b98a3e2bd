"""The page on a flight that is simulated, faulted and watched meanwhile."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.wire.label import read_labels

SHORT = Path(__file__).parents[1] / "run" / "short.yaml"
pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[str]:
    """The address of the page of a flight that goes on."""
    scenario = tmp_path / "flight.yaml"
    text = SHORT.read_text().partition("schedule:")[0]
    scenario.write_text(text.replace("duration_s: 8", "duration_s: 900"))
    command = [sys.executable, "-m", "mavproxy_fault.cli", "run", str(scenario), "--speed", "4"]
    command += [
        "--ui",
        "--gcs",
        "off",
        "--zenoh",
        "tcp/127.0.0.1:0",
        "--out",
        str(tmp_path / "out"),
    ]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    yield process.stdout.readline().removeprefix("page: ").strip()
    os.killpg(process.pid, signal.SIGKILL)  # its monitor too; a clean end would write a report
    process.communicate()


def test_faults_armed_by_clicking_are_found_in_flight(
    open_page: Callable[[str], Any], flight: str, tmp_path: Path
) -> None:
    page = open_page(flight)
    page.wait_for_selector("#verdict.calm")
    page.wait_for_selector("#links td:has-text('simulator')")
    page.select_option("#kind", "preset:gps-spoof")
    page.click("#arm")
    page.wait_for_selector("#faults li.active")
    page.wait_for_selector(".chips li.bad:has-text('GPS position')")
    page.wait_for_selector("#verdict.alarm:has-text('GPS position')")

    page.select_option("#kind", "fault:bias")
    page.fill("[data-key=target]", "PSEUDORANGE.G12")
    page.fill("[data-key=value]", "60")
    page.click("#arm")
    page.wait_for_selector("#now:has-text('was above it at')")  # the statistic, its threshold
    page.wait_for_selector(".sat.out:has-text('G12')")

    with page.expect_download() as saved:
        page.click("#save")
    saved.value.save_as(tmp_path / "saved.yaml")
    page.click("#stop")
    page.wait_for_selector("#faults li", state="detached")
    page.set_input_files("#load", tmp_path / "saved.yaml")
    page.wait_for_selector("#faults li.active:has-text('PSEUDORANGE.G12')")
    page.wait_for_selector("#faults li.active:has-text('gps-spoof')")
    page.wait_for_selector("#events li:has-text('bias: fault ended')")
    assert page.complaints == []
    ended = [one.id for one in read_labels(tmp_path / "out" / "labels.jsonl") if one.end_us]
    assert sorted(ended) == ["bias", "gps-spoof"]
