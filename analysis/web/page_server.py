"""The page's server: uvicorn on loopback, standalone or beside a run."""

import argparse
import contextlib
import errno
import json
import os
import secrets
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette

from analysis.web.access_control import AccessControl
from analysis.web.feed import Feed
from analysis.web.routes import LivePage
from analysis.web.run_source import RunSource
from analysis.web.sequence_folder import SequenceFolder
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import DEFAULT_URL, choose_free_port
from mavproxy_fault.links.open_hint import describe_port_owner

DEFAULT_PORT = 8350
NEWS_S = 1.0  # chosen: time for the last message to reach the viewers
FETCH_S = 10.0  # chosen: at most until each has the report; on a busy machine it takes seconds
MAX_VIEWER_MESSAGE = 16_384  # bytes of one message from a viewer, a list of names


def open_socket(port: int | None) -> socket.socket:
    """A listening socket on loopback; port 0 is any free one, None the default if it is free.

    Raises
    ------
    ConfigError
        If the port is in use or invalid.
    """
    if port is None:
        with contextlib.suppress(ConfigError):
            return open_socket(DEFAULT_PORT)
        return open_socket(0)
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port}: is not a port; give 0 to 65535")
    bound = socket.socket()
    # Allow a recently used port to be bound again.
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind(("127.0.0.1", port))
        bound.listen()  # early connections wait for the server
    except OSError as error:
        bound.close()
        who = f" ({describe_port_owner(port, tcp=True)})" if error.errno == errno.EADDRINUSE else ""
        raise ConfigError(f"--port {port}: {error.strerror}{who}; give a free TCP port") from None
    return bound


class PageServer(uvicorn.Server):  # type: ignore[misc]
    """A server that shuts down cleanly at a second Ctrl-C too, within a second."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Shut down; at a second signal uvicorn would leave the source's thread running."""
        super().handle_exit(sig, frame)
        self.force_exit = False


def prepare_server(
    zenoh: str | None,
    port: int | None = None,
    config_file: str = "",
    commands: bool = False,
    sequences: Path | None = None,
    feed: Feed | None = None,
) -> tuple[PageServer, RunSource, socket.socket, str]:
    """The server, not started, its source, its socket, and the address with the token.

    The page may command the vehicle with `commands`, and stores test sequences in `sequences`.

    Raises
    ------
    ConfigError
        If the port is in use or invalid, or the sequence folder does not exist.
    """
    folder = SequenceFolder(sequences)
    bound = open_socket(port)
    access, address = access_for(bound)
    feed = feed or Feed()
    source = RunSource(feed, zenoh, config_file)
    page = LivePage(feed, source, access, folder, commands)
    return make_server(page.app), source, bound, address


def access_for(bound: socket.socket) -> tuple[AccessControl, str]:
    """Access control of a page on a socket, and the address with a new token."""
    number = bound.getsockname()[1]
    # 18 random bytes cannot be guessed.
    token = secrets.token_urlsafe(18)
    # Only these host names: others that resolve to loopback are refused.
    hosts = frozenset({f"127.0.0.1:{number}", f"localhost:{number}"})
    # After the `#`: browsers do not send this part.
    # Root reads everything anyway, and a container's port may be served by it.
    users = frozenset({os.getuid(), 0}) if hasattr(os, "getuid") else frozenset()
    return AccessControl(token, hosts, users), f"http://127.0.0.1:{number}/#token={token}"


def make_server(app: Starlette) -> PageServer:
    """Create a server for the routes, not started."""
    return PageServer(
        uvicorn.Config(
            app,
            ws="websockets-sansio",
            ws_max_size=MAX_VIEWER_MESSAGE,
            # Compression would cost more than everything else; loopback is fast.
            ws_per_message_deflate=False,
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=1,
        )
    )


@contextlib.contextmanager
def serve_in_thread(server: PageServer, bound: socket.socket) -> Iterator[None]:
    """Run a server on a socket in a thread inside a `with` block."""
    thread = threading.Thread(target=server.run, args=([bound],), name="page")
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()
        bound.close()


@contextlib.contextmanager
def serve_page(zenoh: str | None = None, **options: Any) -> Iterator[str]:
    """Serve the page that `prepare_server` prepares with the same parameters, from a thread inside
    a `with` block; yields the address to open."""
    server, source, bound, address = prepare_server(zenoh, **options)
    with contextlib.closing(source), serve_in_thread(server, bound):
        yield address


@contextlib.contextmanager
def serve_beside(args: argparse.Namespace) -> Iterator[None]:
    """Serve the page during a run, from its preparation on; the run sets `args.out` to its folder.

    Raises
    ------
    ConfigError
        If Zenoh is off.
    """
    if args.zenoh == "off":
        raise ConfigError("--ui: the page needs Zenoh; leave out --zenoh off")
    # An explicit address: a run may skip a failing default one, and the page would show nothing.
    # Without a port the address would differ from the proxy's.
    args.zenoh = DEFAULT_URL if args.zenoh == "auto" else choose_free_port(args.zenoh)
    # The vehicle is simulated: commands are allowed.
    feed = Feed()
    with serve_page(args.zenoh, config_file=args.zenoh_config, commands=True, feed=feed) as address:
        print(f"page: {address}", flush=True)
        yield
        if args.out:
            announce_end(feed, Path(args.out))


def announce_end(feed: Feed, folder: Path) -> None:
    """Leave the result and the report of a flight with the viewers, before the server ends."""
    # The report has imported them by now; a page by itself does not need them.
    from analysis.report.page.report_tables import criteria_reasons
    from analysis.scoring.run_remarks import fault_remarks
    from analysis.scoring.vehicle_outcome import VehicleOutcome, describe_vehicle

    file, report = folder / "summary.json", folder / "report.html"
    if file.is_file():
        summary = json.loads(file.read_text())
        found = summary.get("outcome") and msgspec.convert(summary["outcome"], VehicleOutcome)
        end = {
            "verdict": summary["verdict"],
            "reasons": [text for _, text in criteria_reasons(summary)],
            "vehicle": found and describe_vehicle(found),
            "faults": [{**row, "remarks": fault_remarks(row)} for row in summary.get("faults", ())],
        }
        written = report.is_file()
        feed.announce_end(end, report.resolve() if written else None)
        until_s = time.monotonic() + (FETCH_S if written else NEWS_S)
        for _ in range(feed.viewers):
            feed.fetched.acquire(timeout=max(until_s - time.monotonic(), 0.0))


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    server, source, bound, address = prepare_server(
        args.zenoh, args.port, args.zenoh_config, args.allow_commands, args.sequences
    )
    # uvicorn restores the signal handlers when it ends, before everything is closed here.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, server.handle_exit)
    print(f"page: {address}", flush=True)
    start_s = time.monotonic()
    try:
        server.run([bound])
    finally:
        source.close()
    print(f"stopped after {time.monotonic() - start_s:.0f} s", flush=True)
    return 0
