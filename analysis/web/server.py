"""The page's server: Starlette and uvicorn on loopback.

Looking is free for whoever reaches the port by its own name; whatever changes something needs the
token that stands in the address printed at the start.
"""

import argparse
import asyncio
import contextlib
import re
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from analysis.web.feed import Feed
from analysis.web.source import Source
from mavproxy_fault.errors import ConfigError
from mavproxy_fault.links.bus import with_port

USUAL_PORT = 8350
TICK_S = 0.02
CROWD = 10  # with so many viewers more, batches come a tick later and hold more
LARGEST_BODY = 1_000_000
LARGEST_WISH = 16_384
HERE = Path(__file__).parent / "assets"
PLOTS = Path(__file__).parents[1] / "report" / "assets"
FILES = {
    **{path.name: path for path in HERE.iterdir() if path.suffix in (".js", ".css")},
    **{name: PLOTS / name for name in ("uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")},
}
CONTROL = re.compile(r"fault/[\w.-]+/(arm|disarm|value)|schedule/(load|save|stop)", re.ASCII)
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
Endpoint = Callable[[Request], Awaitable[Response]]


class Page:
    """The page's routes over one source of data; `hosts` are the names it may be called by."""

    def __init__(self, feed: Feed, source: Source, token: str, hosts: frozenset[str]) -> None:
        self._feed, self._source = feed, source
        self._token, self._hosts = token, hosts
        self.app = Starlette(
            routes=[
                Route("/", self._index),
                Route("/assets/{name}", self._asset),
                Route("/api/catalogue", self._catalogue),
                Route("/api/preview", self._preview, methods=["POST"]),
                Route("/api/run", self._choose, methods=["POST"]),
                Route("/api/ctl/{what:path}", self._control, methods=["POST"]),
                WebSocketRoute("/api/live", self._live),
            ],
            lifespan=self._lifespan,
        )

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._source.start()
        ticking = asyncio.create_task(self._tick())
        try:
            yield
        finally:
            ticking.cancel()
            await run_in_threadpool(self._source.close)

    async def _tick(self) -> None:
        while True:
            self._feed.tick()
            await asyncio.sleep(TICK_S * (1 + self._feed.viewers // CROWD))

    # -- who may -----------------------------------------------------------------------------------

    def _refusal(self, call: HTTPConnection, *, changes: bool = False) -> str | None:
        """Why a call is refused; None if it is not."""
        if call.headers.get("host") not in self._hosts:
            return "this page is served on loopback by its own name only"
        origin = call.headers.get("origin")
        if origin is not None and origin.removeprefix("http://") not in self._hosts:
            return "another site's page may not use this one"
        given = call.headers.get("x-token", "")
        if changes and not secrets.compare_digest(given.encode(), self._token.encode()):
            return "the token is wrong; open the address that was printed at the start"
        return None

    async def _body(self, request: Request) -> bytes:
        """The body, up to a size that any schedule stays below.

        Raises
        ------
        ConfigError
            If it is larger.
        """
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > LARGEST_BODY:
                raise ConfigError(f"the request is larger than {LARGEST_BODY} bytes; send less")
        return body

    # -- routes ------------------------------------------------------------------------------------

    async def _index(self, request: Request) -> Response:
        return self._file(request, HERE / "index.html")

    async def _asset(self, request: Request) -> Response:
        path = FILES.get(request.path_params["name"])
        return said(404, "there is no such file") if path is None else self._file(request, path)

    def _file(self, request: Request, path: Path) -> Response:
        refusal = self._refusal(request)
        return said(403, refusal) if refusal else FileResponse(path, headers=HEADERS)

    async def _catalogue(self, request: Request) -> Response:
        refusal = self._refusal(request)
        if refusal:
            return said(403, refusal)
        data = await run_in_threadpool(offered)
        return Response(data, media_type="application/json", headers=HEADERS)

    async def _preview(self, request: Request) -> Response:
        refusal = self._refusal(request, changes=True)
        if refusal:
            return said(403, refusal)
        try:
            body = await self._body(request)
            return JSONResponse(await run_in_threadpool(previewed, body))
        except ConfigError as error:  # a form half filled in is nothing wrong
            return JSONResponse({"curves": [], "error": str(error)}, headers=HEADERS)

    async def _choose(self, request: Request) -> Response:
        refusal = self._refusal(request, changes=True)
        if refusal:
            return said(403, refusal)
        try:
            self._source.choose((await self._body(request)).decode("utf-8", "replace"))
        except ConfigError as error:
            return said(400, str(error))
        return JSONResponse({})

    async def _control(self, request: Request) -> Response:
        refusal = self._refusal(request, changes=True)
        if refusal:
            return said(403, refusal)
        what = request.path_params["what"]
        if CONTROL.fullmatch(what) is None:
            return said(404, f"{what} is unknown; ids take letters, digits, dots, - and _")
        try:
            body = await self._body(request)
            reply = await run_in_threadpool(self._source.ask, what, body)
        except ConfigError as error:
            return said(400, str(error))
        return Response(reply, media_type="application/json")

    async def _live(self, socket: WebSocket) -> None:
        if self._refusal(socket):
            await socket.close(1008)
            return
        await socket.accept()
        try:
            viewer = self._feed.join()
        except ConfigError as error:
            await socket.close(1013, str(error))
            return
        sending = asyncio.create_task(send(socket, viewer.queue))
        try:
            while True:
                viewer.wish(await socket.receive_text())
        except WebSocketDisconnect:
            pass
        finally:
            self._feed.leave(viewer)
            sending.cancel()


async def send(socket: WebSocket, queue: "asyncio.Queue[str]") -> None:
    """Send batches until the viewer leaves; waits while its connection is full."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.send_text(await queue.get())


def offered() -> bytes:
    """The catalogue; the faults are loaded when the first page asks, not at the start."""
    from analysis.web.offer import catalogue

    return catalogue()


def previewed(body: bytes) -> dict[str, Any]:
    """The drawing of an entry, likewise.

    Raises
    ------
    ConfigError
        If the entry is wrong.
    """
    from analysis.web.offer import preview

    return preview(body)


def said(status: int, text: str) -> JSONResponse:
    """A refusal with its reason."""
    return JSONResponse({"error": text}, status, headers=HEADERS)


def listen(port: int | None) -> socket.socket:
    """A socket on loopback; port 0 is any free one, None the usual one where it is free.

    Raises
    ------
    ConfigError
        If the port is taken.
    """
    if port is None:
        with contextlib.suppress(ConfigError):
            return listen(USUAL_PORT)
        return listen(0)
    found = socket.socket()
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
    token = secrets.token_urlsafe(18)
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
    return uvicorn.Server(config), bound, f"http://127.0.0.1:{number}/#token={token}"


@contextlib.contextmanager
def serve(zenoh: str | None = None, port: int | None = None) -> Iterator[str]:
    """Serve the page from a thread for the length of the block; the address to open.

    Raises
    ------
    ConfigError
        If the port is taken.
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
