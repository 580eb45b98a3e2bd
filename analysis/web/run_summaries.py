"""What each run on the bus is doing, in a row, where there are several at once."""

from typing import Any

import msgspec

from mavproxy_fault.links.bus import ROOT

STATE, VERDICT = "schedule/state", "fdi/main/stat"
SUBSCRIBED = (STATE, VERDICT)


class RunSummaries:
    """The newest state and verdict of every run; noted from the bus's threads, read by another."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, str], bytes] = {}

    def add_sample(self, key: str, payload: bytes) -> None:
        """Keep the newest; it is read when somebody wants to see it."""
        run, _, what = key.removeprefix(f"{ROOT}/").partition("/")
        self._newest[run, what] = payload

    def summaries_of(self, runs: list[str]) -> dict[str, dict[str, Any]]:
        """By run: how many faults it has, which act, and what its detector blames."""
        # What belongs to a run that is gone would be told of its successor.
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
