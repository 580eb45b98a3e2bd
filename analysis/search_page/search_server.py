"""`search --interactive`: fly one test at a time, show it on a page, save it on request."""

import argparse
import asyncio
import contextlib
from pathlib import Path

from analysis.report.run_folder import numbered_folder
from analysis.search.search_command import apply_options
from analysis.search.search_session import SearchSession
from analysis.search.space.test_file import TestFile, read_test
from analysis.search_page.flight_routes import FlightPage
from analysis.search_page.flights import Flights
from analysis.web.page_server import access_for, make_server, open_socket
from mavproxy_fault.documents.errors import ConfigError


def make_flights(test: TestFile, folder: Path) -> Flights:
    """The flights of a test file; none has started.

    Raises
    ------
    ConfigError
        If the simulator flies the test, which records no trace.
    """
    if test.simulated:
        raise ConfigError(
            "--interactive: shows only compiled flights; leave out scenario, choose"
            " another estimator than autopilot or fusion"
        )
    return Flights(SearchSession(test, folder))


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, then print the saved files."""
    folder = Path(args.out) if args.out else numbered_folder("search")
    flights = make_flights(apply_options(read_test(args.testfile), args), folder)
    bound = open_socket(None)
    access, address = access_for(bound)
    server = make_server(FlightPage(flights, access).app)
    # Ctrl-C before uvicorn has begun to serve cancels its task.
    with contextlib.suppress(KeyboardInterrupt, asyncio.CancelledError):
        print(f"page: {address}", flush=True)
        server.run([bound])
    flights.close()
    saved = [str(path) for path in flights.saved]
    print(*(saved or ["nothing was saved"]), sep="\n")
    return 0
