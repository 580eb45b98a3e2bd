"""Read the flights behind the paths that a user gives: group logs of one flight and load them."""

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from analysis.recordings.flight_logs.autopilot_logs import is_autopilot_log, read_topics
from analysis.report.curves.recording import FlightData, join_recordings
from analysis.report.recordings.from_autopilot_log import recording_of_log
from analysis.report.recordings.from_results import axis_start, recording_of_results
from analysis.report.recordings.from_tlog import merge_logs, recording_of_tlog
from analysis.report.recordings.reading_bar import reading_bar
from analysis.report.recordings.thinning import WHOLE_BYTES, block_thinning, read_contents
from analysis.results import Result, decode, read_results
from mavproxy_fault.app.recorder import LABELS, RECEIVED, SENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.dialect import describe_unknown
from mavproxy_fault.wire.label import Label, read_labels
from mavproxy_fault.wire.written import written_bytes

MCAP_MAGIC = b"\x89MCAP0\r\n"
THINNED = (
    "{} is large ({:.0f} MB): rows of frequent messages are omitted, but no peaks; percentiles are "
    "biased to the extremes"
)
RUN_LOGS = (SENT, RECEIVED)  # as sent is what the autopilot read
LEAST_SHARE = 0.01  # chosen: least share of frames in a file that counts as a tlog


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """One flight: its data, and the labels, results and summary of a run folder."""

    recording: FlightData
    paths: tuple[Path, ...]
    labels: Sequence[Label] = ()
    results: Sequence[Result] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)


def group_logs(paths: Sequence[Path]) -> list[list[Path]]:
    """Group paths by flight: tlogs that overlap in time belong together, others are one flight
    each."""
    groups: list[list[Path]] = []
    spans: list[tuple[int, int] | None] = []
    for path in paths:
        span = _span(path)
        for i, other in enumerate(spans):
            if span and other and span[0] <= other[1] and other[0] <= span[1]:
                groups[i].append(path)
                spans[i] = (min(span[0], other[0]), max(span[1], other[1]))
                break
        else:
            groups.append([path])
            spans.append(span)
    return groups


def _span(path: Path) -> tuple[int, int] | None:
    if path.is_dir() or path.suffix == ".jsonl" or _is_mcap(path) or is_autopilot_log(path):
        return None
    return tlog.extent_us(path)


def _is_mcap(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(MCAP_MAGIC)) == MCAP_MAGIC


def is_run_folder(folder: Path) -> bool:
    """Whether a folder is a run folder."""
    return any((folder / name).is_file() for name in RUN_LOGS)


def _run_folder_of(path: Path) -> Path | None:
    """The run folder that holds a log: one of its own, or the autopilot's."""
    if path.name in RUN_LOGS:
        return path.parent
    above = [one.parent for one in path.resolve().parents if one.name == "autopilot"]
    return next(filter(is_run_folder, above), None)


@np.errstate(invalid="ignore", over="ignore")  # a log may hold any bits as a number
def read_flight(paths: Sequence[Path], labels: Sequence[Label]) -> RecordedFlight:
    """Read the flight in a group of paths; a log of a run is read with the run's labels, results
    and summary, so that each has the verdict of the run.

    Raises
    ------
    ConfigError
        If a file is missing, empty, or not a supported log.
    """
    path = paths[0]
    run = path if path.is_dir() else _run_folder_of(path)
    results: list[Result] = []
    summary: dict[str, Any] = {}
    if run is not None:
        if not labels and (run / LABELS).is_file():
            labels = read_labels(run / LABELS)
        results = _results(run / "results.jsonl")
        summary = _summary(run / "summary.json")
    t0_us = labels[0].t0_us if labels else None
    if path.is_dir():
        if not is_run_folder(path):
            raise ConfigError(f"{path}: neither sent.tlog nor received.tlog; give a run folder")
        sent = next(path / name for name in RUN_LOGS if (path / name).is_file())
        recording = replace(_tlogs([sent], t0_us), name=path.name)
    elif path.suffix == ".jsonl" or _is_mcap(path):
        return _results_alone(path, labels)
    elif is_autopilot_log(path):
        size = written_bytes(path)
        with reading_bar(path) as progress:
            log = read_topics(path, thin=block_thinning(size), progress=progress)
        recording = recording_of_log(log, path.stem, t0_us)
        thinned = THINNED.format(path.stem, size / 1e6)
        recording.notes.extend([thinned] if size > WHOLE_BYTES else [])
    else:
        recording = _tlogs(paths, t0_us)
    if not (recording.signals or recording.spans or recording.events or recording.links):
        raise ConfigError(
            f"{paths[0]}: the log holds no data that a report shows; give a complete log"
        )
    if not path.is_dir():
        recording.notes.extend(filter(None, map(_unwritten, paths)))
    return _with_labels(RecordedFlight(recording, tuple(paths), labels, results, summary))


def _unwritten(path: Path) -> str:
    """A note on a file whose end was never written."""
    hole = path.stat().st_size - written_bytes(path)
    return f"the last {hole / 1e6:.1f} MB of {path.name} were never written" if hole else ""


def _tlogs(paths: Sequence[Path], t0_us: int | None) -> FlightData:
    logs = {}
    for path in paths:
        with reading_bar(path) as progress:
            log = logs[path.name] = read_contents(path, progress)
        if log.frames == 0 or log.junk_bytes > (1 - LEAST_SHARE) * log.size:
            raise ConfigError(
                f"{path}: {log.size} bytes without MAVLink frames; give a tlog, a ULog or an "
                "ArduPilot dataflash log"
            )
    links = {name if len(logs) > 1 else "": log.links for name, log in logs.items()}
    columns = merge_logs([log.columns for log in logs.values()])
    found = recording_of_tlog(
        columns, name=" + ".join(Path(n).stem for n in logs), t0_us=t0_us, links=links
    )
    unknown = sum((log.unknown for log in logs.values()), Counter())
    notes = [describe_unknown(unknown)] if unknown else []
    notes += [note for log in logs.values() for note in log.notes]
    notes += [THINNED.format(name, log.size / 1e6) for name, log in logs.items() if log.thinned]
    return replace(
        found,
        notes=found.notes + notes,
        size=sum(log.size for log in logs.values()),
        junk_bytes=sum(log.junk_bytes for log in logs.values()),
    )


def _summary(path: Path) -> dict[str, Any]:
    """The summary of a run; empty where it wrote none."""
    if not path.is_file():
        return {}
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except msgspec.DecodeError as error:
        raise ConfigError(f"{path}: {error}; remove the file, or run again") from error


def _results(path: Path) -> list[Result]:
    if not path.is_file():
        return []
    try:
        return list(read_results(path))
    except msgspec.DecodeError as error:
        raise ConfigError(f"{path}: {error}; each line must be a result") from error


def _results_alone(path: Path, labels: Sequence[Label]) -> RecordedFlight:
    """Read results without their log, from `results.jsonl` or an exported MCAP file."""
    results = _results(path) if path.suffix == ".jsonl" else _mcap_results(path)
    if not results:
        raise ConfigError(f"{path}: no results in the file; give results.jsonl or its MCAP export")
    t0_us = axis_start(labels, results) or 0
    recording = recording_of_results(labels, results, t0_us)
    end_s = (max(result.t_us for result in results) - t0_us) * 1e-6
    return RecordedFlight(
        replace(recording, name=path.stem, duration_s=end_s), (path,), labels, results
    )


def _mcap_results(path: Path) -> list[Result]:
    error_type = import_extra("mcap.exceptions").McapError
    make_reader = import_extra("mcap.reader").make_reader

    try:
        with path.open("rb") as file:
            return [
                decode(message.data)
                for _, channel, message in make_reader(file).iter_messages()
                if channel.topic.startswith("/results/")
            ]
    except (error_type, msgspec.DecodeError, OSError, ValueError, EOFError, struct.error) as error:
        raise ConfigError(f"{path}: {error}; give a complete MCAP file of results") from error


def _with_labels(flight: RecordedFlight) -> RecordedFlight:
    if not flight.labels and not flight.results:
        return flight
    judged = recording_of_results(flight.labels, flight.results, flight.recording.t0_us)
    return replace(flight, recording=join_recordings(flight.recording, judged))
