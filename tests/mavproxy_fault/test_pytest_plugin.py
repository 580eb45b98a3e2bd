import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "pytest"
FLIES = """
import pytest
SHORT = {
    "name": "short", "duration_s": 4,
    "start": {"lat_deg": 47.4, "lon_deg": 8.5, "alt_m": 488.0, "height_m": 100.0},
    "mission": [{"shape": "eight", "size_m": 800, "height_m": 100, "speed_mps": 25}],
}

@pytest.mark.fault("bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=1, id="first")
@pytest.mark.fault("drop", target="HIL_SENSOR", at_s=2, for_s=1, id="second")
def test_it(flight):
    run = flight(SHORT)
    assert [label.id for label in run.labels] == ["first", "second"]
    assert run.verdict == "SURPRISE"
"""


def pytest_in(folder: Path, base: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a user's pytest with the installed plugin only."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--basetemp", str(base)]
    return subprocess.run(
        [*command, *words], cwd=folder, capture_output=True, text=True, check=False
    )


def test_the_example_project_passes(tmp_path: Path) -> None:
    done = pytest_in(EXAMPLE, tmp_path / "base")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout


def test_a_failed_flight_prints_its_folder_and_report(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(FLIES)
    done = pytest_in(tmp_path, tmp_path / "base")
    assert "SURPRISE" in done.stdout, "the markers' faults were in the labels, then it failed"
    (page,) = (tmp_path / "base").glob("test_it0/flight-1/report.html")
    assert f"report  {page}" in done.stdout


def test_a_failed_proxy_test_writes_logs_and_a_report(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(
        "def test_it(autopilot):\n"
        "    autopilot.proxy.wait_for('HEARTBEAT.type > 0', timeout_s=30)\n"
        "    assert False\n"
    )
    done = pytest_in(tmp_path, tmp_path / "base")
    (page,) = (tmp_path / "base").glob("test_it0/proxy/report/report.html")
    assert f"report  {page}" in done.stdout
    assert (page.parents[1] / "received.tlog").stat().st_size > 0
