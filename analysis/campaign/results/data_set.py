"""Export a campaign's flights as a labelled data set to train or compare detectors.

    README.md               the data card: content, versions, seeds, licence, columns
    cells.parquet           a row for each cell: fault, magnitude, onset, outcome, flight
    flights/KEY/MESSAGE.received.parquet, MESSAGE.sent.parquet, labels.parquet

`received` is before the faults, `sent` after them; HIL_STATE_QUATERNION is the truth, ATTITUDE and
similar messages are an autopilot's estimates.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.flight_process import RUN_FOLDER
from analysis.campaign.cell import file_key
from analysis.campaign.results.campaign_report import flatten_result
from analysis.campaign.results_store import read_campaign_folder
from mavproxy_fault import __version__
from mavproxy_fault.app.recorder import LABELS, RECEIVED, SENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns

FLIGHTS = "flights"


def export_data_set(folder: Path, out: Path) -> None:
    """Write the data set of a campaign with kept flights.

    Raises
    ------
    ConfigError
        If no flight was kept.
    """
    campaign, results = read_campaign_folder(folder)
    kept = _kept_flights(folder / FLIGHTS)
    if not kept:
        raise ConfigError(f"{folder}: has no kept flights; fly with --dataset or keep: all")
    (out / FLIGHTS).mkdir(parents=True, exist_ok=True)
    for name, path in kept.items():
        write_flight(path, out / FLIGHTS / name)
    rows = [
        {**flatten_result(r), "onset": str(r.cell.onset), "flight": _flight(r, kept)}
        for r in results
    ]
    _write_table(_arrow().Table.from_pylist(rows), out / "cells.parquet")
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
    """Return the log folder of each kept flight, by the flight's name."""
    # An autopilot's flight has a run folder of its own, beside its schedule.
    runs = {log.parent.parent.name: log.parent for log in flights.glob(f"*/{RUN_FOLDER}/{SENT}")}
    return runs | {log.parent.name: log.parent for log in flights.glob(f"*/{SENT}")}


def _flight(result: Any, kept: dict[str, Path]) -> str:
    """Return the folder name of a cell's flight, which subjects may share."""
    _, _, rest = result.cell.key.partition("|")
    # Subjects that share a flight differ only in the first part of the key.
    suffix = "-" + file_key(*rest.split("|"))
    own = file_key(*result.cell.key.split("|"))
    return own if own in kept else next((name for name in kept if name.endswith(suffix)), "")


def write_flight(folder: Path, out: Path) -> None:
    """Write the messages of a flight before and after the faults, and its labels."""
    out.mkdir(exist_ok=True)
    for side in (RECEIVED, SENT):
        for message, rows in read_columns(folder / side).items():
            table = _arrow().table({name: _column(rows[name]) for name in rows.dtype.names or ()})
            _write_table(table, out / f"{message}.{Path(side).stem}.parquet")
    labels = [msgspec.to_builtins(label) for label in read_labels(folder / LABELS)]
    # Fixed keys, so that the columns are the same for every fault.
    keys = ("id", "fault", "targets", "start_us", "end_us", "frames", "magnitude", "by")
    applied = [{key: label.get(key) for key in keys} for label in labels]
    # An explicit schema, since a flight without faults has no rows to infer it from.
    pa = _arrow()
    schema = pa.schema(
        [("id", pa.string()), ("fault", pa.string()), ("targets", pa.list_(pa.string())),
         ("start_us", pa.int64()), ("end_us", pa.int64()), ("frames", pa.int64()),
         ("magnitude", pa.float64()), ("by", pa.string())]
    )  # fmt: skip
    _write_table(pa.Table.from_pylist(applied, schema), out / "labels.parquet")


def _column(values: Any) -> Any:
    """Convert one column; array fields become lists."""
    return _arrow().array(values.tolist() if values.ndim > 1 else values)


def _arrow() -> Any:
    return import_extra("pyarrow")


def _write_table(table: Any, path: Path) -> None:
    import_extra("pyarrow.parquet").write_table(table, path)
