"""`search --interactive`: fly one test at a time, look at it on a page, save it, go on."""

import argparse
import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

from analysis.search.search_command import chosen, new_folder
from analysis.search.search_session import Session
from analysis.search.space.test_file import TestFile, read_test
from analysis.search_page.flight_routes import FlightPage
from analysis.search_page.flights import Flights
from analysis.web.page_server import PageServer, guarded, in_thread, listen, server_of
from mavproxy_fault.documents.errors import ConfigError


def flights_of(test: TestFile, folder: Path) -> Flights:
    """The flights of a test file, of which none has begun.

    Raises
    ------
    ConfigError
        If the simulator flies the test, which leaves no trace to draw.
    """
    if test.flown:
        raise ConfigError(
            "--interactive: shows flights of the compiled kernels; leave out scenario, and choose"
            " another estimator than autopilot or fusion"
        )
    return Flights(Session(test, folder))


def prepare(flights: Flights, port: int | None) -> tuple[PageServer, socket.socket, str]:
    """A server that is not started, its socket, and the address with the token.

    Raises
    ------
    ConfigError
        If the port is taken or none.
    """
    bound = listen(port)
    gate, address = guarded(bound)
    return server_of(FlightPage(flights, gate).app), bound, address


@contextlib.contextmanager
def serve(flights: Flights, port: int | None = None) -> Iterator[str]:
    """Serve the page from a thread for the length of the block; the address to open."""
    server, bound, address = prepare(flights, port)
    with in_thread(server, bound):
        yield address


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, and say what was saved."""
    folder = Path(args.out) if args.out else new_folder(Path("runs"))
    flights = flights_of(chosen(read_test(args.testfile), args), folder)
    server, bound, address = prepare(flights, None)
    with contextlib.suppress(KeyboardInterrupt):
        print(f"page: {address}", flush=True)
        server.run([bound])
    flights.close()
    saved = [str(path) for path in flights.saved]
    print(*(saved or ["nothing was saved"]), sep="\n")
    return 0
