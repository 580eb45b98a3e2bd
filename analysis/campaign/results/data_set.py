"""A campaign's flights as a labelled data set for people who train or compare detectors.

    README.md               the data card: what it is, versions, seeds, licence, columns
    cells.parquet           a row for each cell: fault, magnitude, onset, outcome, file
    flights/KEY/MESSAGE.received.parquet, MESSAGE.sent.parquet, labels.parquet

`received` is what the sensors said, `sent` what was left after the faults; the truth is the message
HIL_STATE_QUATERNION, an autopilot's estimate ATTITUDE and its like.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from analysis.autopilots.flight_process import RUN_FOLDER
from analysis.campaign.cell import file_key
from analysis.campaign.results.campaign_report import flatten_result
from analysis.campaign.results_store import read_campaign_folder
from mavproxy_fault import __version__
from mavproxy_fault.app.recorder import LABELS, RECEIVED, SENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns

FLIGHTS = "flights"


def export_data_set(folder: Path, out: Path) -> None:
    """Write the data set of a campaign whose flights were kept.

    Raises
    ------
    ConfigError
        If they were not.
    """
    campaign, results = read_campaign_folder(folder)
    kept = _kept_flights(folder / FLIGHTS)
    if not kept:
        raise ConfigError(f"{folder}: no flight was kept; fly with --dataset, or with keep: all")
    (out / FLIGHTS).mkdir(parents=True, exist_ok=True)
    for name, path in kept.items():
        write_flight(path, out / FLIGHTS / name)
    rows = [
        {**flatten_result(r), "onset": str(r.cell.onset), "flight": _flight(r, kept)}
        for r in results
    ]
    pq.write_table(pa.Table.from_pylist(rows), out / "cells.parquet")
    card = files("analysis.campaign.results") / "assets" / "data_card.md"
    (out / "README.md").write_text(
        card.read_text(encoding="utf-8").format(
            name=campaign.name,
            cells=len(results),
            version=__version__,
            subjects=", ".join(sorted({r.cell.subject for r in results})),
            faults=", ".join(fault.name for fault in campaign.faults),
            seeds=", ".join(map(str, campaign.seeds)),
        )
    )


def _kept_flights(flights: Path) -> dict[str, Path]:
    """Where the logs of each kept flight lie, by the flight's name."""
    # An autopilot's flight is a run with a folder of its own, beside the schedule it was given.
    runs = {log.parent.parent.name: log.parent for log in flights.glob(f"*/{RUN_FOLDER}/{SENT}")}
    return runs | {log.parent.name: log.parent for log in flights.glob(f"*/{SENT}")}


def _flight(result: Any, kept: dict[str, Path]) -> str:
    """The folder of a cell's flight: its own, or that of the subject which shares it."""
    _, _, rest = result.cell.key.partition("|")
    # Subjects that share a flight differ in the first part of the key alone.
    suffix = "-" + file_key(*rest.split("|"))
    own = file_key(*result.cell.key.split("|"))
    return own if own in kept else next((name for name in kept if name.endswith(suffix)), "")


def write_flight(folder: Path, out: Path) -> None:
    """The messages of a flight before and after the faults, and its labels."""
    out.mkdir(exist_ok=True)
    for side in (RECEIVED, SENT):
        for message, rows in read_columns(folder / side).items():
            table = pa.table({name: _column(rows[name]) for name in rows.dtype.names or ()})
            pq.write_table(table, out / f"{message}.{Path(side).stem}.parquet")
    labels = [msgspec.to_builtins(label) for label in read_labels(folder / LABELS)]
    # Without an order of its own, so that a data set has the same columns for every fault.
    keys = ("id", "fault", "targets", "start_us", "end_us", "frames", "magnitude")
    applied = [{key: label.get(key) for key in keys} for label in labels]
    # A schema, since a flight without faults has no rows to infer one from.
    schema = pa.schema(
        [("id", pa.string()), ("fault", pa.string()), ("targets", pa.list_(pa.string())),
         ("start_us", pa.int64()), ("end_us", pa.int64()), ("frames", pa.int64()),
         ("magnitude", pa.float64())]
    )  # fmt: skip
    pq.write_table(pa.Table.from_pylist(applied, schema), out / "labels.parquet")


def _column(values: Any) -> Any:
    """One column; arrays within a message become lists."""
    return pa.array(values.tolist() if values.ndim > 1 else values)
