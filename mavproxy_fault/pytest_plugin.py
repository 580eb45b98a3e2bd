"""Fixtures for tests of code that talks to a vehicle: `fault_proxy`, `autopilot` and `flight`.

`@pytest.mark.fault("bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=5)` puts a fault into the
schedule of the fixture that the test requests; its keys are those of a schedule entry. A failed
test prints the folder of its logs and its report.
"""

import contextlib
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

# pytest loads this file in every project of the environment, so the fixtures do the heavy imports.
if TYPE_CHECKING:
    from mavproxy_fault.api.proxy_handle import Proxy
    from mavproxy_fault.api.result_folders import Run

MASTER, OUT, COMMAND = "fault_master", "fault_out", "fault_autopilot"
SIMULATED = (
    f"{shlex.quote(sys.executable)} -P -m mavproxy_fault.cli sim --gcs udpout:127.0.0.1:{{port}}"
)
SHUTDOWN_TIMEOUT_S = 10.0  # chosen: time for a vehicle to close its logs before it is killed
FOLDERS = pytest.StashKey[dict[Path, Path]]()  # log folder to report
FAILED = pytest.StashKey[bool]()


@dataclass(frozen=True)
class ProxiedAutopilot:
    """A vehicle behind a proxy; `url` is its address for MAVSDK, `link` for pymavlink."""

    proxy: "Proxy"
    url: str
    link: str


def pytest_addoption(parser: pytest.Parser) -> None:
    """Register the options for the proxy's links and the vehicle's command."""
    parser.addini(MASTER, "the vehicle's connection string", default="udpin:127.0.0.1:0")
    parser.addini(OUT, "the connection string for the code under test", default="udpin:127.0.0.1:0")
    parser.addini(COMMAND, "starts a vehicle that sends to UDP {port}", default=SIMULATED)


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line("markers", "fault(name, **keys): a fault of the test's schedule")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Add the paths of logs and report to a failure."""
    report = yield
    # Set before the teardown of the fixtures, which read it.
    if report.when == "call" and report.failed:
        item.stash[FAILED] = True
        for folder, page in item.stash.get(FOLDERS, {}).items():
            report.sections.append(("mavproxy-fault", f"logs    {folder}\nreport  {page}"))
    return report


@pytest.fixture
def fault_proxy(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator["Proxy"]:
    """A proxy between `fault_master` and `fault_out`, with the faults of the test's markers."""
    from mavproxy_fault.api.proxy_handle import Proxy

    folder = tmp_path / "proxy"
    _register_folder(request.node, folder, folder / "report" / "report.html")
    master, out = (request.config.getini(name) for name in (MASTER, OUT))
    with Proxy(master, out, schedule=_schedule(request.node), logdir=folder) as proxy:
        yield proxy
    # The logs are complete only after the proxy has closed.
    if request.node.stash.get(FAILED, False):
        _write_report(folder)


@pytest.fixture
def autopilot(
    request: pytest.FixtureRequest, fault_proxy: "Proxy", tmp_path: Path
) -> Iterator[ProxiedAutopilot]:
    """A vehicle behind `fault_proxy`, started by the command `fault_autopilot`."""
    vehicle, station = fault_proxy.addresses
    port = vehicle.rsplit(":", 1)[1]
    arguments = shlex.split(request.config.getini(COMMAND).replace("{port}", port))
    with (tmp_path / "autopilot.log").open("wb") as log:
        # In its own session, so that processes started by the vehicle can be ended too.
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        try:
            host = station.partition(":")[2]
            yield ProxiedAutopilot(fault_proxy, f"udpout://{host}", f"udpout:{host}")
        finally:
            _end_process(process)


@pytest.fixture
def flight(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., "Run"]:
    """`mavproxy_fault.run` with the faults of the test's markers and a folder of the test's."""
    from mavproxy_fault.api.command_calls import run

    folders: list[Path] = []

    def run_flight(scenario: Any = None, **keywords: Any) -> "Run":
        folder = tmp_path / f"flight-{len(folders) + 1}"
        folders.append(folder)
        _register_folder(request.node, folder, folder / "report.html")
        schedule = _schedule(request.node)
        if schedule["faults"]:
            keywords.setdefault("schedule", schedule)
        return run(scenario, **{"out": folder, **keywords})

    return run_flight


def _schedule(item: pytest.Item) -> dict[str, Any]:
    """Return the faults of a test's markers in source order."""
    from mavproxy_fault.app.inject import live_entry

    faults = []
    # pytest yields the marker nearest to the function first.
    for mark in reversed(list(item.iter_markers("fault"))):
        name, keys = mark.args[0], dict(mark.kwargs)
        target, value = keys.pop("target", None), keys.pop("value", None)
        faults.append(live_entry(name, target, value, keys))
    return {"faults": faults}


def _register_folder(item: pytest.Item, folder: Path, report: Path) -> None:
    item.stash.setdefault(FOLDERS, {})[folder] = report


def _write_report(folder: Path) -> None:
    """Write the report of a failed test; an error here must not hide the test's failure."""
    arguments = [str(folder / "sent.tlog"), "--labels", str(folder / "labels.jsonl")]
    command = [sys.executable, "-P", "-m", "mavproxy_fault.cli", "report", *arguments]
    subprocess.run([*command, "--out", str(folder / "report")], capture_output=True, check=False)


def _end_process(process: subprocess.Popen[bytes]) -> None:
    """End the vehicle and all processes that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, 15)
    try:
        process.wait(SHUTDOWN_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
