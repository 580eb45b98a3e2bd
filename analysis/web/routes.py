"""The page's routes; access is checked by `access_control`."""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from analysis.web.access_control import (
    ASSETS,
    HEADERS,
    AccessControl,
    action_answer,
    data_answer,
    file_answer,
    file_routes,
    read_body,
    refusal_answer,
)
from analysis.web.feed import Feed
from analysis.web.form_data import fault_catalogue, preview_entry
from analysis.web.run_source import RunSource
from analysis.web.sequence import check_sequence, refuse_commands
from analysis.web.sequence_folder import SequenceFolder
from mavproxy_fault.documents.errors import ConfigError

TICK_S = 0.04  # one batch per tick: 25 a second are smooth on a screen
VIEWERS_PER_TICK = 20  # for every so many viewers batches come one tick later
# Ids must not contain wildcards of the bus: a request names one key.
CONTROL = re.compile(r"fault/[^/*$?#]+/(arm|disarm|value)|schedule/(load|begin|save|stop)")


class LivePage:
    """The page's routes for one data source; `commands` allows commands to the vehicle."""

    def __init__(
        self,
        feed: Feed,
        source: RunSource,
        access: AccessControl,
        sequences: SequenceFolder,
        commands: bool,
    ) -> None:
        self._feed, self._source, self._sequences = feed, source, sequences
        self._commands = commands
        self.app = Starlette(
            routes=[
                *file_routes(ASSETS, "index.html"),
                Route("/api/catalogue", self._catalogue),
                Route("/api/report", self._report),
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
            middleware=[Middleware(access.guard)],
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
            await asyncio.sleep(TICK_S * (1 + self._feed.viewers // VIEWERS_PER_TICK))

    async def _report(self, request: Request) -> Response:
        self._feed.fetched.release()
        return file_answer(self._feed.report)

    async def _catalogue(self, request: Request) -> Response:
        # In a thread: the first call takes longer than a tick.
        return await data_answer(fault_catalogue)

    async def _preview(self, request: Request) -> Response:
        try:
            body = await read_body(request)
            return JSONResponse(await run_in_threadpool(preview_entry, body))
        except ConfigError as error:  # an incomplete form is not an error
            return JSONResponse({"curves": [], "error": str(error)}, headers=HEADERS)

    async def _choose(self, request: Request) -> Response:
        def act(body: bytes) -> dict[str, Any]:
            self._source.choose(body.decode("utf-8", "replace"))
            return {}

        return await action_answer(request, act)

    async def _check(self, request: Request) -> Response:
        return await action_answer(request, check_sequence)

    async def _allowed(self, request: Request) -> Response:
        """What the token allows: commands to the vehicle, stored sequences."""
        known = {"commands": self._commands, "sequences": self._sequences.names()}
        return await action_answer(request, lambda _: known)

    async def _read(self, request: Request) -> Response:
        name = request.path_params["name"]
        return await action_answer(request, lambda _: check_sequence(self._sequences.read(name)))

    async def _write(self, request: Request) -> Response:
        def act(body: bytes) -> dict[str, Any]:
            self._sequences.write(request.path_params["name"], check_sequence(body)["yaml"])
            return {"sequences": self._sequences.names()}

        return await action_answer(request, act)

    async def _control(self, request: Request) -> Response:
        what = request.path_params["what"]
        if CONTROL.fullmatch(what) is None:
            return refusal_answer(
                404, f"{what} is unknown; ids consist of letters, digits, dots, - and _"
            )

        def act(body: bytes) -> Any:
            if not self._commands:
                refuse_commands(what, body)
            return msgspec.json.decode(self._source.query(what, body))

        return await action_answer(request, act)

    async def _live(self, socket: WebSocket) -> None:
        await socket.accept()
        try:
            viewer = self._feed.add_viewer()
        except ConfigError as error:
            # 1013: try again later.
            await socket.close(1013, str(error))
            return
        sending = asyncio.create_task(send_batches(socket, viewer.queue))
        try:
            while True:
                viewer.request_messages(await socket.receive_text())
        except WebSocketDisconnect:
            pass
        finally:
            self._feed.remove_viewer(viewer)
            sending.cancel()


async def send_batches(socket: WebSocket, queue: "asyncio.Queue[str]") -> None:
    """Send batches until the viewer disconnects; waits while its connection is busy."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.send_text(await queue.get())
