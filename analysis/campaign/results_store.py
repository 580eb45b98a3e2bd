"""The results of a campaign in its folder, from which an interrupted campaign continues.

campaign.json    the campaign file as read
cells.jsonl      one result per line, flushed at once
curves.jsonl     the curves of each flight that has some
twins.jsonl      the fault-free reference flights
"""

from io import FileIO
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import ABORTED
from analysis.flying.flight_evidence import CampaignFlight, Evidence
from mavproxy_fault.documents.errors import ConfigError

CAMPAIGN, CELLS, CURVES, REFERENCE_FLIGHTS = (
    "campaign.json",
    "cells.jsonl",
    "curves.jsonl",
    "twins.jsonl",
)
BASELINE = "baseline.json"  # all that a comparison needs
T = TypeVar("T")


class CellEvidence(msgspec.Struct, frozen=True):
    """The evidence of a cell, with the cell's key."""

    key: str
    evidence: Evidence


class ReferenceFlightRecord(msgspec.Struct, frozen=True):
    """A reference flight with its key."""

    key: str
    flown: CampaignFlight


class ResultsStore:
    """Open files of a campaign; `results` by key, without aborted cells.

    Raises
    ------
    ConfigError
        If the folder contains another campaign.
    """

    def __init__(self, folder: Path, campaign: CampaignFile) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        written = msgspec.json.encode(campaign)
        path = folder / CAMPAIGN
        # Any difference makes it another campaign, except a key that an older version did not have.
        if path.exists() and msgspec.json.encode(read_campaign_json(path)) != written:
            raise ConfigError(f"--out {folder}: contains another campaign; choose another folder")
        path.write_bytes(written)
        # Aborted cells are repeated, since the reason may be gone.
        self.results = {
            result.cell.key: result
            for result in read_lines(folder / CELLS, CellResult)
            if result.outcome != ABORTED
        }
        self.reference_flights = {
            record.key: record.flown
            for record in read_lines(folder / REFERENCE_FLIGHTS, ReferenceFlightRecord)
        }
        self._files = {
            name: open_for_append(folder / name) for name in (CELLS, CURVES, REFERENCE_FLIGHTS)
        }
        self._encoder = msgspec.json.Encoder()

    def add(self, results: list[CellResult], flown: CampaignFlight | None) -> None:
        """Store the results of a job, and the curves of its flight."""
        self.results |= {result.cell.key: result for result in results}
        self._write(CELLS, results)
        if flown is not None:
            evidence = flown.evidence
            self._write(
                CURVES, [CellEvidence(r.cell.key, evidence[r.cell.subject]) for r in results]
            )

    def add_reference(self, key: str, flown: CampaignFlight) -> None:
        """Store a reference flight."""
        self.reference_flights[key] = flown
        self._write(REFERENCE_FLIGHTS, [ReferenceFlightRecord(key, flown)])

    def _write(self, name: str, items: list[Any]) -> None:
        """Write all lines at once, so that a kill corrupts the last line at most."""
        self._files[name].write(self._encoder.encode_lines(items))

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()


def open_for_append(path: Path) -> FileIO:
    """Open a file to append lines, and remove an incomplete last line."""
    file = FileIO(path, "a+")
    file.seek(0)
    # -1 + 1 without a complete line: the file is emptied.
    file.truncate(file.read().rfind(b"\n") + 1)
    return file


def read_lines(path: Path, kind: type[T]) -> list[T]:
    """Decode the complete lines of a file; none if the file does not exist."""
    if not path.is_file():
        return []
    decoder = msgspec.json.Decoder(kind)
    # A kill may leave an incomplete last line.
    lines = path.read_bytes().splitlines(keepends=True)
    return [decoder.decode(line) for line in lines if line.endswith(b"\n")]


def read_campaign_json(path: Path) -> CampaignFile:
    """Read `campaign.json`."""
    return msgspec.json.decode(path.read_bytes(), type=CampaignFile)


def read_results(path: Path) -> list[CellResult]:
    """Read the results of a completed campaign: of its folder, or of its baseline file.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    if not path.is_file():
        return read_campaign_folder(path)[1]
    try:
        return msgspec.json.decode(path.read_bytes(), type=list[CellResult])
    except msgspec.MsgspecError as error:
        raise ConfigError(f"{path}: {error}; give the {BASELINE} of a campaign") from None


def read_campaign_folder(folder: Path) -> tuple[CampaignFile, list[CellResult]]:
    """Read a campaign and its results; the last one of each cell.

    Raises
    ------
    ConfigError
        If the folder contains no campaign.
    """
    path = folder / CAMPAIGN
    if not path.is_file():
        raise ConfigError(f"{folder}: contains no campaign; give the folder of a completed one")
    campaign = read_campaign_json(path)
    results = {result.cell.key: result for result in read_lines(folder / CELLS, CellResult)}
    return campaign, list(results.values())
