"""A flight ends: what its page shows, and what its report and files say."""

import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analysis.results import Decision, SensorDecision, read_results
from mavproxy_fault.wire.label import read_labels

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
# A quad whose satellite fails, which is found, whose gyroscope has a bias too small to be found,
# and whose motor fails: it crashes.
SCENARIO = """
name: three-faults
seed: 3
duration_s: 12
start: {height_m: 30}
vehicle: {kind: multirotor, parameters: iris}
mission: [{shape: s, size_m: 60, height_m: 30, speed_mps: 4, laps: 3}]
sensors:
  imu: {preset: consumer-mems, rate_hz: 100}
  mag: {preset: consumer-mag, rate_hz: 25}
  baro: {preset: consumer-baro, rate_hz: 25}
gnss: {rate_hz: 5, mask_deg: 10}
schedule:
  faults:
    - {id: step, fault: bias, target: PSEUDORANGE.G12, value: 50, at_s: 2, for_s: 2}
    - {id: tiny, fault: bias, target: HIL_SENSOR.xgyro, value: 0.0005, at_s: 2, for_s: 2}
    - {id: motor, preset: motor-failure, at_s: 6}
"""
INTERVAL = re.compile(r"isolation ended: fault in (?:satellite )?(.+) from ([\d.]+) to ([\d.]+) s;")


def fly(open_page: Callable[[str], Any], folder: Path) -> Any:
    """The page of a flight that has ended."""
    (folder / "flight.yaml").write_text(SCENARIO)
    command = [sys.executable, "-m", "mavproxy_fault.cli", "run", "flight.yaml", "--ui", "--gcs"]
    command += ["off", "--zenoh", "tcp/127.0.0.1:0", "--speed", "2", "--out", "out"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page = open_page(process.stdout.readline().removeprefix("page: ").strip())
        page.wait_for_selector("#connection:has-text('The flight has ended')")
        process.communicate()
    assert process.returncode == 1  # a fault was missed
    return page


def isolations(file: Path, t0_us: int) -> list[tuple[str, float, float]]:
    """Satellite or sensor, first and last time of every isolation of a file of results."""
    found: list[tuple[str, float, float]] = []
    now: dict[str, dict[str, list[float]]] = defaultdict(dict)  # by detector and part
    for result in sorted(read_results(file), key=lambda result: result.t_us):
        if isinstance(result, Decision):
            detector, bad = "", result.excluded
        elif isinstance(result, SensorDecision):
            detector = result.sensor
            bad = (result.suspect or detector,) if result.isolated else ()
        else:
            continue
        t_s, parts = (result.t_us - t0_us) * 1e-6, now[detector]
        for part in [part for part in parts if part not in bad]:
            found.append((part, *parts.pop(part)))  # type: ignore[arg-type]
        for part in bad:
            parts.setdefault(part, [t_s, t_s])[1] = t_s
    return found + [(part, *times) for parts in now.values() for part, times in parts.items()]  # type: ignore[misc]


def test_the_page_of_a_flight_that_ended_agrees_with_its_report_and_files(
    open_page: Callable[[str], Any], browser: Any, tmp_path: Path
) -> None:
    page = fly(open_page, tmp_path)
    folder = tmp_path / "out"
    report = browser.new_page()
    report.goto((folder / "report.html").as_uri())
    summary = json.loads((folder / "summary.json").read_text())

    assert f"The flight has ended: {summary['verdict']}. " in page.inner_text("header")
    assert report.inner_text("header .FAIL, header .PASS") == summary["verdict"] == "FAIL"
    assert "vehicle crashed; lost control at" in page.inner_text("#result")
    assert "crashed" in report.inner_text("body")
    assert not page.is_visible("#verdict")  # it would be green
    assert not page.is_visible("#form")  # no server would answer

    table = report.locator("table:has(th:text-is('delay, s')) tbody tr").all()
    rows = [row.locator("td").all_inner_texts() for row in table]
    shown = [one.inner_text() for one in page.locator("#faults li").all()]
    assert len(rows) == len(shown) == 3
    for (name, target, start, end, frames, delay, isolated, verdict, _), text in zip(
        rows, shown, strict=True
    ):
        assert text.startswith(f"{name} {verdict}\n{target}, {start} to {end} s, {frames} frames")
        found = f"detected after {delay} s; isolated: {isolated}" if delay else "not detected"
        assert text.endswith(found)
    verdicts = {row[0]: row[7] for row in rows}
    assert verdicts == {"step": "isolated", "tiny": "missed", "motor": "isolated"}

    labels = read_labels(folder / "labels.jsonl")
    events = page.inner_text("#events")
    on_page = {(part, float(a), float(b)) for part, a, b in INTERVAL.findall(events)}
    in_file = isolations(folder / "results.jsonl", labels[0].t0_us)
    assert {part for part, _, _ in in_file} >= {"G12", "motor 1"}
    assert on_page == {(part, round(a, 1), round(b, 1)) for part, a, b in in_file}
    for label in labels:
        assert f"{label.id}: fault " in events
    # The flight lost no frame.
    missing = page.locator("#links td:nth-child(5)").all_inner_texts()
    assert set(missing) == {"0"}
    assert page.complaints == []
