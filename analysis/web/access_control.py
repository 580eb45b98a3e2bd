"""Access control of a page, for all of its routes at once, and their responses.

Reading is open to programs of the user who started the page, and to clients with the token in the
address printed at the start; changes need the token.
"""

import re
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from analysis.web.peer_user import HAS_TABLES, peer_user
from mavproxy_fault.documents.errors import ConfigError

MAX_BODY_BYTES = 1_000_000  # larger than any schedule
ASSETS = Path(__file__).parent / "assets"
PLOT_ASSETS = Path(__file__).parents[1] / "report" / "page" / "assets"
ASSET_FILES = {
    **{path.name: path for path in ASSETS.iterdir() if path.suffix in (".js", ".css")},
    **{
        name: PLOT_ASSETS / name for name in ("uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")
    },
}
OWN_FILES = re.compile(r"/|/assets/[^/]*")
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class AccessControl(NamedTuple):
    """The token, the allowed host names, and the users who may read without the token."""

    token: str
    hosts: frozenset[str]
    users: frozenset[int]

    def guard(self, app: ASGIApp) -> ASGIApp:
        """Refuse a call before any route sees it."""

        async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
            answer, kind = app, scope["type"]
            if kind in ("http", "websocket") and (refusal := self.refusal(HTTPConnection(scope))):
                # uvicorn answers the close with 403; another answer it would log as an error.
                closes = kind == "websocket"
                answer = WebSocketClose(1008, refusal) if closes else refusal_answer(403, refusal)
            await answer(scope, receive, send)

        return guarded

    def refusal(self, call: HTTPConnection) -> str | None:
        """Why a call is refused; None if it is allowed."""
        # DNS rebinding: another site could reach the port under its own name.
        if call.headers.get("host") not in self.hosts:
            return "unknown host name; open the page at the address printed at the start"
        origin = call.headers.get("origin")
        # Browsers send the origin of a call; programs do not.
        if origin is not None and origin.removeprefix("http://") not in self.hosts:
            return "requests from other sites are not allowed; open this page itself"
        # A browser's WebSocket has no headers of its own.
        token_sent = call.headers.get("x-token", "") or call.query_params.get("token", "")
        # Constant-time comparison: the delay must not reveal how much matched.
        if secrets.compare_digest(token_sent.encode(), self.token.encode()):
            return None
        changes = call.scope.get("method", "GET") not in ("GET", "HEAD")
        # Before a browser has the page's own files, it cannot send the token.
        needs_none = not HAS_TABLES and OWN_FILES.fullmatch(call.url.path)
        if not changes and (self._is_own(call) or needs_none):
            return None
        return "the token is wrong; open the address printed at the start"

    def _is_own(self, call: HTTPConnection) -> bool:
        """Whether a program of the same user calls."""
        if call.client is None or call.scope.get("server") is None:
            return False
        host, port = call.scope["server"]
        return peer_user((call.client.host, call.client.port), (host, port)) in self.users


def file_routes(folder: Path, index: str) -> list[BaseRoute]:
    """The routes of a page's own files: those of its folder, and those that all pages share."""
    files = ASSET_FILES | {path.name: path for path in folder.iterdir()}

    async def page(request: Request) -> Response:
        return file_answer(folder / index)

    async def asset(request: Request) -> Response:
        return file_answer(files.get(request.path_params["name"]))

    return [Route("/", page), Route("/assets/{name}", asset)]


def file_answer(path: Path | None) -> Response:
    """Return a file, 404 without one."""
    if path is None:
        return refusal_answer(404, "no such file")
    return FileResponse(path, headers=HEADERS)


async def data_answer(data: Callable[[], bytes]) -> Response:
    """Return JSON data, computed in a thread."""
    content = await run_in_threadpool(data)
    return Response(content, media_type="application/json", headers=HEADERS)


async def action_answer(request: Request, act: Callable[[bytes], dict[str, Any]]) -> Response:
    """Return the result of `act` on the body, run in a thread; a ConfigError gives status 400."""
    try:
        answer = await run_in_threadpool(act, await read_body(request))
        # Unlike Starlette's, msgspec writes what is no number as null.
        return Response(msgspec.json.encode(answer), media_type="application/json")
    except ConfigError as error:
        return refusal_answer(400, str(error))


async def read_body(request: Request) -> bytes:
    """Read the body, up to `MAX_BODY_BYTES`.

    Raises
    ------
    ConfigError
        If it is larger.
    """
    body = b""
    # Counted while reading: the announced length may be wrong.
    async for part in request.stream():
        body += part
        if len(body) > MAX_BODY_BYTES:
            raise ConfigError(f"the request is larger than {MAX_BODY_BYTES} bytes; send less")
    return body


def refusal_answer(status: int, text: str) -> JSONResponse:
    """An error response with its reason."""
    return JSONResponse({"error": text}, status, headers=HEADERS)
