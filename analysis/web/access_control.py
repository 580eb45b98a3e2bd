"""Who may call a page's routes, and how they answer.

Looking is free for whoever reaches the port by its own name; whatever changes something needs the
token that stands in the address printed at the start.
"""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response

from mavproxy_fault.documents.errors import ConfigError

MAX_BODY_BYTES = 1_000_000
ASSETS = Path(__file__).parent / "assets"
PLOT_ASSETS = Path(__file__).parents[1] / "report" / "page" / "assets"
ASSET_FILES = {
    **{path.name: path for path in ASSETS.iterdir() if path.suffix in (".js", ".css")},
    **{
        name: PLOT_ASSETS / name for name in ("uPlot.iife.min.js", "uPlot.min.css", "uPlot.LICENSE")
    },
}
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class AccessControl(NamedTuple):
    """The token of changes, and the names to call the page by."""

    token: str
    hosts: frozenset[str]

    def refusal(self, call: HTTPConnection, *, changes: bool = False) -> str | None:
        """Why a call is refused; None if it is not."""
        # A page of another site could reach the port by a name of its own.
        if call.headers.get("host") not in self.hosts:
            return "this page is served on loopback by its own name only"
        origin = call.headers.get("origin")
        # A browser tells where a call comes from; programs send no origin.
        if origin is not None and origin.removeprefix("http://") not in self.hosts:
            return "another site's page may not use this one"
        given = call.headers.get("x-token", "")
        # In constant time: the answer's delay must not tell how much was right.
        if changes and not secrets.compare_digest(given.encode(), self.token.encode()):
            return "the token is wrong; open the address that was printed at the start"
        return None

    def file(self, request: Request, path: Path | None) -> Response:
        """A file, if there is one."""
        refusal = self.refusal(request)
        if refusal:
            return refusal_answer(403, refusal)
        if path is None:
            return refusal_answer(404, "there is no such file")
        return FileResponse(path, headers=HEADERS)

    async def get_data(self, request: Request, data: Callable[[], bytes]) -> Response:
        """JSON for whoever looks, made in a thread of its own."""
        refusal = self.refusal(request)
        if refusal:
            return refusal_answer(403, refusal)
        found = await run_in_threadpool(data)
        return Response(found, media_type="application/json", headers=HEADERS)

    async def run_action(
        self, request: Request, act: Callable[[bytes], dict[str, Any]]
    ) -> Response:
        """What `act` makes of the body, in a thread of its own; its ConfigError is a refusal."""
        refusal = self.refusal(request, changes=True)
        if refusal:
            return refusal_answer(403, refusal)
        try:
            return JSONResponse(await run_in_threadpool(act, await read_body(request)))
        except ConfigError as error:
            return refusal_answer(400, str(error))


async def read_body(request: Request) -> bytes:
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
        if len(body) > MAX_BODY_BYTES:
            raise ConfigError(f"the request is larger than {MAX_BODY_BYTES} bytes; send less")
    return body


def refusal_answer(status: int, text: str) -> JSONResponse:
    """A refusal with its reason."""
    return JSONResponse({"error": text}, status, headers=HEADERS)
