"""The flights of a session, flown in a thread while the page stays responsive."""

import threading
from pathlib import Path

import msgspec

from analysis.search.search_session import SearchSession
from analysis.search_page.flight_data import flight_data
from mavproxy_fault.documents.errors import ConfigError, users_path


class Flights:
    """Flies one test at a time; keeps the newest flight as JSON."""

    def __init__(self, session: SearchSession) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._number: int | None = None
        self._newest = b"null"
        self._failed = False
        self.saved: list[Path] = []

    def next(self) -> None:
        """Start the next test.

        Raises
        ------
        ConfigError
            If one is still in flight.
        """
        with self._lock:
            self._refuse_in_flight()
            self._thread = threading.Thread(target=self._fly, name="flight")
            self._thread.start()

    def save(self) -> list[str]:
        """Save the displayed test; returns the files.

        Raises
        ------
        ConfigError
            If none is displayed, or it cannot be written.
        """
        with self._lock:
            self._refuse_in_flight()
            if self._number is None or self._failed:
                raise ConfigError("no test is displayed; fly one first")
            where = f"{self._session.folder}: cannot be written"
            with users_path(where, "give another folder with --out"):
                files = self._session.save()
            self.saved += [one for one in files if one not in self.saved]
            return [str(one) for one in files]

    def state(self) -> bytes:
        """Number of the displayed test, whether one is in flight, whether the last one failed."""
        flying = self._flying()
        return msgspec.json.encode(
            {"number": self._number, "flying": flying, "failed": self._failed and not flying}
        )

    def newest(self) -> bytes:
        """The displayed flight as JSON; null if there is none yet."""
        return self._newest

    def close(self) -> None:
        """Wait for the current flight."""
        if self._thread is not None:
            self._thread.join()

    def _fly(self) -> None:
        self._failed = True  # until it ends
        self._session.next()
        self._newest = flight_data(self._session)
        self._number = self._session.number
        self._failed = False

    def _flying(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _refuse_in_flight(self) -> None:
        if self._flying():
            raise ConfigError("a test is in flight; wait until it ends")
