"""What a campaign knows so far, in its folder; read again when it goes on after a kill.

campaign.json    the file, as it was read
cells.jsonl      a result a line, flushed at once
curves.jsonl     the curves of each flight that has some
twins.jsonl      the flights without a fault
"""

from io import FileIO
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CampaignFlight, CellResult, Evidence
from analysis.campaign.outcomes import ABORTED
from mavproxy_fault.documents.errors import ConfigError

CAMPAIGN, CELLS, CURVES, REFERENCE_FLIGHTS = (
    "campaign.json",
    "cells.jsonl",
    "curves.jsonl",
    "twins.jsonl",
)
T = TypeVar("T")


class CellEvidence(msgspec.Struct, frozen=True):
    """The evidence of a cell by its key."""

    key: str
    evidence: Evidence


class ReferenceFlightRecord(msgspec.Struct, frozen=True):
    """The flight without a fault, by its key."""

    key: str
    flown: CampaignFlight


class ResultsStore:
    """Open files of a campaign; `results` by key do not hold what was aborted.

    Raises
    ------
    ConfigError
        If the folder holds another campaign.
    """

    def __init__(self, folder: Path, campaign: CampaignFile) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        written = msgspec.json.encode(campaign)
        known = folder / CAMPAIGN
        # Bytes, not data: whatever differs makes it another campaign.
        if known.exists() and known.read_bytes() != written:
            raise ConfigError(f"--out {folder}: holds another campaign; name another folder")
        known.write_bytes(written)
        # Aborted cells are flown again: the reason may be gone.
        self.results = {
            result.cell.key: result
            for result in read_lines(folder / CELLS, CellResult)
            if result.outcome != ABORTED
        }
        self.reference_flights = {
            twin.key: twin.flown
            for twin in read_lines(folder / REFERENCE_FLIGHTS, ReferenceFlightRecord)
        }
        self._files = {
            name: open_for_append(folder / name) for name in (CELLS, CURVES, REFERENCE_FLIGHTS)
        }
        self._encoder = msgspec.json.Encoder()

    def add(self, results: list[CellResult], flown: CampaignFlight | None) -> None:
        """Keep the results of a job, and the curves of its flight."""
        self.results |= {result.cell.key: result for result in results}
        self._write(CELLS, results)
        if flown is not None:
            evidence = flown.evidence
            self._write(
                CURVES, [CellEvidence(r.cell.key, evidence[r.cell.subject]) for r in results]
            )

    def add_reference(self, key: str, flown: CampaignFlight) -> None:
        """Keep a flight without a fault."""
        self.reference_flights[key] = flown
        self._write(REFERENCE_FLIGHTS, [ReferenceFlightRecord(key, flown)])

    def _write(self, name: str, items: list[Any]) -> None:
        """One write for all, so that a kill leaves whole lines but the last."""
        self._files[name].write(self._encoder.encode_lines(items))

    def close(self) -> None:
        """Close the files."""
        for file in self._files.values():
            file.close()


def open_for_append(path: Path) -> FileIO:
    """A file to append lines to, without the part of a line that a kill left at its end."""
    # Read and append: the cut line goes, the rest stays.
    file = FileIO(path, "a+")
    file.seek(0)
    # -1 + 1 where there is no line: the file is emptied.
    file.truncate(file.read().rfind(b"\n") + 1)
    return file


def read_lines(path: Path, kind: type[T]) -> list[T]:
    """The whole lines of a file; none if there is no such file."""
    if not path.is_file():
        return []
    decoder = msgspec.json.Decoder(kind)
    # A kill may have cut the last line.
    lines = path.read_bytes().splitlines(keepends=True)
    return [decoder.decode(line) for line in lines if line.endswith(b"\n")]


def read_campaign_folder(folder: Path) -> tuple[CampaignFile, list[CellResult]]:
    """A campaign and its results; of several of one cell the last.

    Raises
    ------
    ConfigError
        If there is no campaign in the folder.
    """
    path = folder / CAMPAIGN
    if not path.is_file():
        raise ConfigError(f"{folder}: holds no campaign; name the folder of one that was flown")
    campaign = msgspec.json.decode(path.read_bytes(), type=CampaignFile)
    results = {result.cell.key: result for result in read_lines(folder / CELLS, CellResult)}
    return campaign, list(results.values())
