"""A summary of each run on the bus, for the page's row of runs."""

from typing import Any

import msgspec

from mavproxy_fault.links.bus import ROOT

STATE, VERDICT = "schedule/state", "fdi/main/stat"
SUBSCRIBED = (STATE, VERDICT)


class RunSummaries:
    """The newest state and verdict of every run; thread-safe for one reader."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, str], bytes] = {}

    def add_sample(self, key: str, payload: bytes) -> None:
        """Keep the newest sample; it is decoded when it is needed."""
        run, _, what = key.removeprefix(f"{ROOT}/").partition("/")
        self._newest[run, what] = payload

    def summaries_of(self, runs: list[str]) -> dict[str, dict[str, Any]]:
        """By run: the number of faults, the active ones, and what its detector isolated."""
        # Data of an ended run must not be shown for a later one of that name.
        for run, what in list(self._newest):
            if run not in runs:
                self._newest.pop((run, what), None)
        return {run: self._row(run) for run in runs}

    def _row(self, run: str) -> dict[str, Any]:
        faults = self._read(run, STATE).get("faults", [])
        verdict = self._read(run, VERDICT)
        return {
            "faults": len(faults),
            "acting": [one["id"] for one in faults if one["state"] == "active"],
            "blamed": verdict.get("excluded", [])
            or ([] if not verdict.get("alarm") else ["alarm"]),
        }

    def _read(self, run: str, what: str) -> dict[str, Any]:
        payload = self._newest.get((run, what))
        found = {} if payload is None else msgspec.json.decode(payload)
        return found if isinstance(found, dict) else {}
