"""The page's server: uvicorn on loopback, alone or beside a run."""

import argparse
import contextlib
import secrets
import socket
import threading
from collections.abc import Iterator

import uvicorn

from analysis.web.feed import Feed
from analysis.web.routes import Page
from analysis.web.run_source import Source
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import with_port

USUAL_PORT = 8350
LARGEST_WISH = 16_384  # bytes that a viewer may say at once


def listen(port: int | None) -> socket.socket:
    """A socket on loopback; port 0 is any free one, None the usual one where it is free.

    Raises
    ------
    ConfigError
        If the port is taken or none.
    """
    if port is None:
        with contextlib.suppress(ConfigError):
            return listen(USUAL_PORT)
        return listen(0)
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
        raise ConfigError(f"--port {port}: {error.strerror}; give a free TCP port") from None
    return found


def prepare(zenoh: str | None, port: int | None) -> tuple[uvicorn.Server, socket.socket, str]:
    """A server that is not started, its socket, and the address to open, with the token."""
    bound = listen(port)
    number = bound.getsockname()[1]
    # 18 bytes of chance: nobody guesses it.
    token = secrets.token_urlsafe(18)
    # Only these names: a foreign name that leads to loopback is refused.
    hosts = frozenset({f"127.0.0.1:{number}", f"localhost:{number}"})
    feed = Feed()
    page = Page(feed, Source(feed, zenoh), token, hosts)
    config = uvicorn.Config(
        page.app,
        ws="websockets-sansio",
        ws_max_size=LARGEST_WISH,
        ws_per_message_deflate=False,  # it would cost more than all the rest, and loopback is wide
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    # Behind the `#`: browsers send that part to nobody.
    return uvicorn.Server(config), bound, f"http://127.0.0.1:{number}/#token={token}"


@contextlib.contextmanager
def serve(zenoh: str | None = None, port: int | None = None) -> Iterator[str]:
    """Serve the page from a thread for the length of the block; the address to open.

    Raises
    ------
    ConfigError
        If the port is taken or none.
    """
    server, bound, address = prepare(zenoh, port)
    thread = threading.Thread(target=server.run, args=([bound],), name="page")
    thread.start()
    try:
        yield address
    finally:
        server.should_exit = True
        thread.join()
        bound.close()


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
    if args.zenoh != "auto":
        # Without a port the address would be another than the proxy's.
        args.zenoh = with_port(args.zenoh)
    with serve(None if args.zenoh == "auto" else args.zenoh) as address:
        print(f"page: {address}", flush=True)
        yield


def main(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    server, bound, address = prepare(args.zenoh, args.port)
    print(f"page: {address}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        server.run([bound])
    return 0
