"""Access control of a page's routes, and their responses.

Reading is open to any client that uses the page's own host name; changes need the token in the
address printed at the start.
"""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, Response

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
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class AccessControl(NamedTuple):
    """The token for changes, and the allowed host names."""

    token: str
    hosts: frozenset[str]

    def refusal(self, call: HTTPConnection, *, changes: bool = False) -> str | None:
        """Why a call is refused; None if it is allowed."""
        # DNS rebinding: another site could reach the port under its own name.
        if call.headers.get("host") not in self.hosts:
            return "unknown host name; open the page at the address printed at the start"
        origin = call.headers.get("origin")
        # Browsers send the origin of a call; programs do not.
        if origin is not None and origin.removeprefix("http://") not in self.hosts:
            return "requests from other sites are not allowed; open this page itself"
        token_sent = call.headers.get("x-token", "")
        # Constant-time comparison: the delay must not reveal how much matched.
        if changes and not secrets.compare_digest(token_sent.encode(), self.token.encode()):
            return "the token is wrong; open the address printed at the start"
        return None

    def file(self, request: Request, path: Path | None) -> Response:
        """Return a file, 404 without one."""
        refusal = self.refusal(request)
        if refusal:
            return refusal_answer(403, refusal)
        if path is None:
            return refusal_answer(404, "no such file")
        return FileResponse(path, headers=HEADERS)

    async def get_data(self, request: Request, data: Callable[[], bytes]) -> Response:
        """Return JSON data, computed in a thread; needs no token."""
        refusal = self.refusal(request)
        if refusal:
            return refusal_answer(403, refusal)
        content = await run_in_threadpool(data)
        return Response(content, media_type="application/json", headers=HEADERS)

    async def run_action(
        self, request: Request, act: Callable[[bytes], dict[str, Any]]
    ) -> Response:
        """Return the result of `act` on the body, run in a thread; a ConfigError gives status
        400."""
        refusal = self.refusal(request, changes=True)
        if refusal:
            return refusal_answer(403, refusal)
        try:
            return JSONResponse(await run_in_threadpool(act, await read_body(request)))
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
