"""`search --interactive`: fly one test at a time, show it on a page, save it on request."""

import argparse
import asyncio
import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

from analysis.search.search_command import apply_options, new_folder
from analysis.search.search_session import SearchSession
from analysis.search.space.test_file import TestFile, read_test
from analysis.search_page.flight_routes import FlightPage
from analysis.search_page.flights import Flights
from analysis.web.page_server import (
    PageServer,
    access_for,
    make_server,
    open_socket,
    serve_in_thread,
)
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
            "--interactive: shows only flights of the compiled kernels; leave out scenario, choose"
            " another estimator than autopilot or fusion"
        )
    return Flights(SearchSession(test, folder))


def prepare_search_server(
    flights: Flights, port: int | None
) -> tuple[PageServer, socket.socket, str]:
    """The server, not started, its socket, and the address with the token.

    Raises
    ------
    ConfigError
        If the port is in use or invalid.
    """
    bound = open_socket(port)
    access, address = access_for(bound)
    return make_server(FlightPage(flights, access).app), bound, address


@contextlib.contextmanager
def serve_search_page(flights: Flights, port: int | None = None) -> Iterator[str]:
    """Serve the page from a thread inside a `with` block; yields the address to open."""
    server, bound, address = prepare_search_server(flights, port)
    with serve_in_thread(server, bound):
        yield address


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, then print the saved files."""
    folder = Path(args.out) if args.out else new_folder(Path("runs"))
    flights = make_flights(apply_options(read_test(args.testfile), args), folder)
    server, bound, address = prepare_search_server(flights, None)
    # Ctrl-C before uvicorn has begun to serve cancels its task.
    with contextlib.suppress(KeyboardInterrupt, asyncio.CancelledError):
        print(f"page: {address}", flush=True)
        server.run([bound])
    flights.close()
    saved = [str(path) for path in flights.saved]
    print(*(saved or ["nothing was saved"]), sep="\n")
    return 0
