"""Fixtures for tests of code that talks to a vehicle: `fault_proxy`, `autopilot` and `flight`.

`@pytest.mark.fault("bias", target="HIL_SENSOR.xgyro", value=0.1, at_s=5)` puts a fault into the
schedule of whichever of them a test asks for; its keys are those of a schedule. A test that fails
names the folder of its logs and the report.
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

# pytest loads this file in every project where we are installed: what is heavy is imported by the
# fixtures.
if TYPE_CHECKING:
    from mavproxy_fault.api.flight_run import Run
    from mavproxy_fault.api.proxy_handle import Proxy

MASTER, OUT, COMMAND = "fault_master", "fault_out", "fault_autopilot"
SIMULATED = (
    f"{shlex.quote(sys.executable)} -m mavproxy_fault.cli sim --gcs udpout:127.0.0.1:{{port}}"
)
SHUTDOWN_TIMEOUT_S = 10.0  # for a vehicle to close its logs, before it is killed
FOLDERS = pytest.StashKey[dict[Path, Path]]()  # a folder of logs to the report that it has
FAILED = pytest.StashKey[bool]()


@dataclass(frozen=True)
class ProxiedAutopilot:
    """A vehicle behind a proxy; `url` is MAVSDK's address of it, `link` pymavlink's."""

    proxy: "Proxy"
    url: str
    link: str


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the proxy's ends are, and what flies."""
    parser.addini(MASTER, "the vehicle's connection string", default="udpin:127.0.0.1:0")
    parser.addini(OUT, "the connection string for the code under test", default="udpin:127.0.0.1:0")
    parser.addini(COMMAND, "starts a vehicle that sends to UDP {port}", default=SIMULATED)


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line("markers", "fault(name, **keys): a fault of the test's schedule")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Tell in a failure where the logs and the report lie."""
    report = yield
    # Noted before the fixtures are torn down: they look at it then.
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
    _announce(request.node, folder, folder / "report" / "report.html")
    master, out = (request.config.getini(name) for name in (MASTER, OUT))
    with Proxy(master, out, schedule=_schedule(request.node), logdir=folder) as proxy:
        yield proxy
    # The proxy is closed by now: only then are its logs whole.
    if request.node.stash.get(FAILED, False):
        _write_report(folder)


@pytest.fixture
def autopilot(
    request: pytest.FixtureRequest, fault_proxy: "Proxy", tmp_path: Path
) -> Iterator[ProxiedAutopilot]:
    """A vehicle behind `fault_proxy`, started by the command `fault_autopilot`."""
    vehicle, station = fault_proxy.addresses
    words = shlex.split(request.config.getini(COMMAND).replace("{port}", vehicle.rsplit(":", 1)[1]))
    with (tmp_path / "autopilot.log").open("wb") as log:
        # In a session of its own: a vehicle may start further programs, and all are to end.
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        try:
            host = station.partition(":")[2]
            yield ProxiedAutopilot(fault_proxy, f"udpout://{host}", f"udpout:{host}")
        finally:
            _end(process)


@pytest.fixture
def flight(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., "Run"]:
    """`mavproxy_fault.run` with the faults of the test's markers and a folder of the test's."""
    from mavproxy_fault.api.flight_run import run

    flown: list[Path] = []

    def fly(scenario: Any = None, **keywords: Any) -> "Run":
        folder = tmp_path / f"flight-{len(flown) + 1}"
        flown.append(folder)
        _announce(request.node, folder, folder / "report.html")
        schedule = _schedule(request.node)
        if schedule["faults"]:
            keywords.setdefault("schedule", schedule)
        return run(scenario, **{"out": folder, **keywords})

    return fly


def _schedule(item: pytest.Item) -> dict[str, Any]:
    """The faults of a test's markers, in the order in which they stand above it."""
    from mavproxy_fault.app.inject import live_entry

    faults = []
    # pytest gives the marker nearest to the function first.
    for mark in reversed(list(item.iter_markers("fault"))):
        name, keys = mark.args[0], dict(mark.kwargs)
        target, value = keys.pop("target", None), keys.pop("value", None)
        faults.append(live_entry(name, target, value, keys))
    return {"faults": faults}


def _announce(item: pytest.Item, folder: Path, report: Path) -> None:
    item.stash.setdefault(FOLDERS, {})[folder] = report


def _write_report(folder: Path) -> None:
    """The report of a failed test's logs; the failure counts, not whether this succeeds."""
    words = [str(folder / "sent.tlog"), "--labels", str(folder / "labels.jsonl")]
    command = [sys.executable, "-m", "mavproxy_fault.cli", "report", *words]
    subprocess.run([*command, "--out", str(folder / "report")], capture_output=True, check=False)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the vehicle and all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, 15)
    try:
        process.wait(SHUTDOWN_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.wait()
