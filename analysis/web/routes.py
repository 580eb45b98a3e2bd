"""The page's routes, and who may call them.

Looking is free for whoever reaches the port by its own name; whatever changes something needs the
token that stands in the address printed at the start.
"""

import asyncio
import contextlib
import re
import secrets
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from analysis.web.feed import Feed
from analysis.web.run_source import Source
from analysis.web.sequence_folder import SequenceFolder
from mavproxy_fault.documents.errors import ConfigError

TICK_S = 0.04  # a batch holds all that came in it; a screen shows no more
CROWD = 20  # with so many viewers more, batches come a tick later and hold more
LARGEST_BODY = 1_000_000
HERE = Path(__file__).parent / "assets"
PLOTS = Path(__file__).parents[1] / "report" / "page" / "assets"
FILES = {
    **{path.name: path for path in HERE.iterdir() if path.suffix in (".js", ".css")},
    **{name: PLOTS / name for name in ("uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")},
}
# Ids hold no wildcards of the bus: a request names one key.
CONTROL = re.compile(r"fault/[^/*$?#]+/(arm|disarm|value)|schedule/(load|begin|save|stop)")
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class Access(NamedTuple):
    """Who may: the token of changes, the names to call the page by, whether it may command."""

    token: str
    hosts: frozenset[str]
    commands: bool = False  # the vehicle: arm, take off, ...


class Page:
    """The page's routes over one source of data."""

    def __init__(
        self, feed: Feed, source: Source, access: Access, sequences: SequenceFolder
    ) -> None:
        self._feed, self._source, self._sequences = feed, source, sequences
        self._access = access
        self.app = Starlette(
            routes=[
                Route("/", self._index),
                Route("/assets/{name}", self._asset),
                Route("/api/catalogue", self._catalogue),
                Route("/api/preview", self._preview, methods=["POST"]),
                Route("/api/run", self._choose, methods=["POST"]),
                Route("/api/sequence/check", self._check, methods=["POST"]),
                Route("/api/allowed", self._allowed, methods=["POST"]),
                Route("/api/sequence/read/{name}", self._read, methods=["POST"]),
                Route("/api/sequence/write/{name}", self._write, methods=["POST"]),
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
        # A page of another site could reach the port by a name of its own.
        if call.headers.get("host") not in self._access.hosts:
            return "this page is served on loopback by its own name only"
        origin = call.headers.get("origin")
        # A browser tells where a call comes from; programs send no origin.
        if origin is not None and origin.removeprefix("http://") not in self._access.hosts:
            return "another site's page may not use this one"
        given = call.headers.get("x-token", "")
        # In constant time: the answer's delay must not tell how much was right.
        if changes and not secrets.compare_digest(given.encode(), self._access.token.encode()):
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
        # Counted as it comes: the length a client announces may be wrong.
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
        return (
            refusal_answer(404, "there is no such file")
            if path is None
            else self._file(request, path)
        )

    def _file(self, request: Request, path: Path) -> Response:
        refusal = self._refusal(request)
        return refusal_answer(403, refusal) if refusal else FileResponse(path, headers=HEADERS)

    async def _catalogue(self, request: Request) -> Response:
        refusal = self._refusal(request)
        if refusal:
            return refusal_answer(403, refusal)
        # The first call loads the faults, which takes longer than a tick.
        data = await run_in_threadpool(offered)
        return Response(data, media_type="application/json", headers=HEADERS)

    async def _preview(self, request: Request) -> Response:
        refusal = self._refusal(request, changes=True)
        if refusal:
            return refusal_answer(403, refusal)
        try:
            body = await self._body(request)
            return JSONResponse(await run_in_threadpool(previewed, body))
        except ConfigError as error:  # a form half filled in is nothing wrong
            return JSONResponse({"curves": [], "error": str(error)}, headers=HEADERS)

    async def _choose(self, request: Request) -> Response:
        def act(body: bytes) -> dict[str, Any]:
            self._source.choose(body.decode("utf-8", "replace"))
            return {}

        return await self._answer(request, act)

    async def _check(self, request: Request) -> Response:
        return await self._answer(request, checked)

    async def _allowed(self, request: Request) -> Response:
        """What whoever has the token may do: command the vehicle, keep sequences."""
        known = {"commands": self._access.commands, "sequences": self._sequences.names()}
        return await self._answer(request, lambda _: known)

    async def _read(self, request: Request) -> Response:
        name = request.path_params["name"]
        return await self._answer(request, lambda _: checked(self._sequences.read(name)))

    async def _write(self, request: Request) -> Response:
        def act(body: bytes) -> dict[str, Any]:
            self._sequences.write(request.path_params["name"], checked(body)["yaml"])
            return {"sequences": self._sequences.names()}

        return await self._answer(request, act)

    async def _answer(self, request: Request, act: Callable[[bytes], dict[str, Any]]) -> Response:
        """What `act` makes of the body, in a thread of its own; its ConfigError is a refusal."""
        refusal = self._refusal(request, changes=True)
        if refusal:
            return refusal_answer(403, refusal)
        try:
            return JSONResponse(await run_in_threadpool(act, await self._body(request)))
        except ConfigError as error:
            return refusal_answer(400, str(error))

    async def _control(self, request: Request) -> Response:
        refusal = self._refusal(request, changes=True)
        if refusal:
            return refusal_answer(403, refusal)
        what = request.path_params["what"]
        if CONTROL.fullmatch(what) is None:
            return refusal_answer(
                404, f"{what} is unknown; ids take letters, digits, dots, - and _"
            )
        try:
            body = await self._body(request)
            if not self._access.commands:
                await run_in_threadpool(refuse_commands, what, body)
            # The bus waits for its answer; the page must go on meanwhile.
            reply = await run_in_threadpool(self._source.ask, what, body)
        except ConfigError as error:
            return refusal_answer(400, str(error))
        return Response(reply, media_type="application/json")

    async def _live(self, socket: WebSocket) -> None:
        if self._refusal(socket):
            # 1008: against the policy.
            await socket.close(1008)
            return
        await socket.accept()
        try:
            viewer = self._feed.join()
        except ConfigError as error:
            # 1013: try again later.
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


def checked(body: bytes) -> dict[str, Any]:
    """A test sequence as a schedule file and as steps, likewise.

    Raises
    ------
    ConfigError
        If it is wrong.
    """
    from analysis.web.sequence import checked

    return checked(body)


def refuse_commands(what: str, body: bytes) -> None:
    """Refuse a query that commands the vehicle, likewise.

    Raises
    ------
    ConfigError
        If it does.
    """
    from analysis.web.sequence import refuse_commands

    refuse_commands(what, body)


def refusal_answer(status: int, text: str) -> JSONResponse:
    """A refusal with its reason."""
    return JSONResponse({"error": text}, status, headers=HEADERS)
