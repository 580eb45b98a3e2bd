"""The page's server: uvicorn on loopback, alone or beside a run."""

import argparse
import contextlib
import errno
import secrets
import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import NamedTuple

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
MAX_VIEWER_MESSAGE = 16_384  # bytes that a viewer may say at once


def open_socket(port: int | None) -> socket.socket:
    """A socket on loopback; port 0 is any free one, None the usual one where it is free.

    Raises
    ------
    ConfigError
        If the port is taken or none.
    """
    if port is None:
        with contextlib.suppress(ConfigError):
            return open_socket(DEFAULT_PORT)
        return open_socket(0)
    if not 0 <= port <= 65535:
        raise ConfigError(f"--port {port}: is no port; allowed: 0 to 65535")
    found = socket.socket()
    # A port that was used a moment ago may be bound again at once.
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind(("127.0.0.1", port))
        found.listen()  # whoever comes before the server is up waits
    except OSError as error:
        found.close()
        who = f" ({describe_port_owner(port, tcp=True)})" if error.errno == errno.EADDRINUSE else ""
        raise ConfigError(f"--port {port}: {error.strerror}{who}; give a free TCP port") from None
    return found


class PageServer(uvicorn.Server):  # type: ignore[misc]
    """A server that ends in order at a second Ctrl-C too: it takes a second at most."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """End; uvicorn would leave the source's thread behind at the second signal."""
        super().handle_exit(sig, frame)
        self.force_exit = False


class PageOptions(NamedTuple):
    """What the page offers beyond faults: commands to the vehicle, a folder of sequences."""

    commands: bool = False
    sequences: Path | None = None


NO_OPTIONS = PageOptions()


def prepare_server(
    zenoh: str | None, port: int | None, config_file: str = "", offer: PageOptions = NO_OPTIONS
) -> tuple[PageServer, RunSource, socket.socket, str]:
    """A server that is not started, its source, its socket, and the address with the token.

    Raises
    ------
    ConfigError
        If the port is taken or none, or the sequences' folder is not there.
    """
    folder = SequenceFolder(offer.sequences)
    bound = open_socket(port)
    gate, address = access_for(bound)
    feed = Feed()
    source = RunSource(feed, zenoh, config_file)
    page = LivePage(feed, source, gate, folder, offer.commands)
    return make_server(page.app), source, bound, address


def access_for(bound: socket.socket) -> tuple[AccessControl, str]:
    """Who may call a page on that socket, and the address with the token."""
    number = bound.getsockname()[1]
    # 18 bytes of chance: nobody guesses it.
    token = secrets.token_urlsafe(18)
    # Only these names: a foreign name that leads to loopback is refused.
    hosts = frozenset({f"127.0.0.1:{number}", f"localhost:{number}"})
    # Behind the `#`: browsers send that part to nobody.
    return AccessControl(token, hosts), f"http://127.0.0.1:{number}/#token={token}"


def make_server(app: Starlette) -> PageServer:
    """A server for the routes, not started yet."""
    return PageServer(
        uvicorn.Config(
            app,
            ws="websockets-sansio",
            ws_max_size=MAX_VIEWER_MESSAGE,
            # It would cost more than all the rest, and loopback is wide.
            ws_per_message_deflate=False,
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=1,
        )
    )


@contextlib.contextmanager
def serve_in_thread(server: PageServer, bound: socket.socket) -> Iterator[None]:
    """Let a server answer on a socket for the length of the block."""
    thread = threading.Thread(target=server.run, args=([bound],), name="page")
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()
        bound.close()


@contextlib.contextmanager
def serve_page(
    zenoh: str | None = None,
    port: int | None = None,
    config_file: str = "",
    offer: PageOptions = NO_OPTIONS,
) -> Iterator[str]:
    """Serve the page from a thread for the length of the block; the address to open.

    Raises
    ------
    ConfigError
        If the port is taken or none.
    """
    server, source, bound, address = prepare_server(zenoh, port, config_file, offer)
    with contextlib.closing(source), serve_in_thread(server, bound):
        yield address


@contextlib.contextmanager
def serve_beside(args: argparse.Namespace) -> Iterator[None]:
    """Serve the page while a run gets ready and goes on.

    Raises
    ------
    ConfigError
        If there is no bus for it to listen to.
    """
    if args.zenoh == "off":
        raise ConfigError("--ui: the page listens on Zenoh; leave out --zenoh off")
    # By name, as a run may do without the default address, but the page shows nothing then. Without
    # a port the address would be another than the proxy's.
    args.zenoh = DEFAULT_URL if args.zenoh == "auto" else choose_free_port(args.zenoh)
    # What flies here is simulated: it may be commanded.
    with serve_page(
        args.zenoh, config_file=args.zenoh_config, offer=PageOptions(commands=True)
    ) as address:
        print(f"page: {address}", flush=True)
        yield


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    offer = PageOptions(args.allow_commands, Path(args.sequences) if args.sequences else None)
    server, source, bound, address = prepare_server(args.zenoh, args.port, args.zenoh_config, offer)
    # uvicorn gives the signals back when it ends, before all has been closed here.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, server.handle_exit)
    print(f"page: {address}", flush=True)
    begun_s = time.monotonic()
    try:
        server.run([bound])
    finally:
        source.close()
    print(f"stopped after {time.monotonic() - begun_s:.0f} s", flush=True)
    return 0
