"""The routes of the search's page; access is checked by `analysis.web.access_control`."""

import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from analysis.search_page.flights import Flights
from analysis.web.access_control import AccessControl, action_answer, data_answer, file_routes

ASSETS = Path(__file__).parent / "assets"


class FlightPage:
    """The HTTP routes of the page that shows a session's flights."""

    def __init__(self, flights: Flights, access: AccessControl) -> None:
        self._flights = flights
        self.app = Starlette(
            routes=[
                *file_routes(ASSETS, "flight.html"),
                Route("/api/state", self._state),
                Route("/api/flight", self._flight),
                Route("/api/next", self._next, methods=["POST"]),
                Route("/api/save", self._save, methods=["POST"]),
            ],
            lifespan=self._lifespan,
            middleware=[Middleware(access.guard)],
        )

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._flights.next()  # so that the page has a flight to show
        yield
        await run_in_threadpool(self._flights.close)

    async def _state(self, request: Request) -> Response:
        return await data_answer(self._flights.state)

    async def _flight(self, request: Request) -> Response:
        return await data_answer(self._flights.newest)

    async def _next(self, request: Request) -> Response:
        def act(_: bytes) -> dict[str, object]:
            self._flights.next()
            return {}

        return await action_answer(request, act)

    async def _save(self, request: Request) -> Response:
        return await action_answer(request, lambda _: {"files": self._flights.save()})
