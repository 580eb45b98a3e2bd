"""A flight for the viewer Rerun (https://rerun.io/docs), on the report's time axis."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import FlightData
from analysis.report.foxglove_views import attitudes, local_places
from mavproxy_fault.documents.extras import import_extra

AXIS_M = 5.0  # chosen: of the axes that show the attitude


def write_rerun(
    path: Path,
    recording: FlightData,
    tables: Iterable[tuple[str, NDArray[np.int64], dict[str, NDArray[Any]]]],
) -> None:
    """Write a recording for Rerun; `tables` are the messages: name, times in ns, columns."""
    rr, views = import_extra("rerun"), import_extra("rerun.blueprint")
    with rr.RecordingStream("mavproxy-fault", recording_id=recording.name) as stream:
        stream.save(path)

        def send(names: Sequence[str], t_s: NDArray[np.floating[Any]], columns: Any) -> None:
            entity = rr.new_entity_path(names)
            stream.send_columns(entity, [rr.TimeColumn("time", duration=t_s)], columns)

        tracks = {track.name: track for track in recording.tracks if track.on_earth}
        for name, track in tracks.items():
            places = np.column_stack([track.lat_deg, track.lon_deg])
            line = local_places(track, next(iter(tracks.values())), track.t_s)
            entity = rr.new_entity_path
            stream.log(entity(["map", name]), rr.GeoLineStrings(lat_lon=[places]), static=True)
            stream.log(entity(["space", name, "path"]), rr.LineStrips3D([line]), static=True)
            send(["map", name, "now"], track.t_s, rr.GeoPoints.columns(positions=places))
        for name, t_s, q, place_m in attitudes(recording, tracks):
            turns = rr.Transform3D.columns(translation=place_m, quaternion=np.roll(q, -1, axis=1))
            send(["space", name, "body"], t_s, turns)
            axes = rr.TransformAxes3D(AXIS_M)
            stream.log(rr.new_entity_path(["space", name, "body"]), axes, static=True)
        for panel, name, t_s, value in recording.signals:
            send(["curves", panel, name], t_s, rr.Scalars.columns(scalars=value))
        for name, stamps_ns, table in tables:
            side, _, message = name.rpartition(".")
            since_s = (stamps_ns - recording.t0_us * 1000) * 1e-9
            for column, values in table.items():
                if values.dtype.kind in "biuf" and len(values):
                    # The viewer holds a value until the next one.
                    kept = slice(None if (values != values[0]).any() else 1)
                    numbers = rr.Scalars.columns(scalars=values[kept].astype(np.float64))
                    send(["messages", message, column, side or "log"], since_s[kept], numbers)
        for lane, group in groupby(sorted(recording.spans), lambda span: span.lane):
            ends = [edge for s in group for edge in ((s.start_s, s.text), (s.end_s, ""))]
            states = rr.StateChange.columns(state=[text for _, text in ends])
            send(["timeline", lane], np.array([at_s for at_s, _ in ends]), states)
        events = recording.events
        lines = rr.TextLog.columns(text=[f"{event.kind}: {event.text}" for event in events])
        send(["log"], np.array([event.t_s for event in events]), lines)
        targets = [s.text.partition(" on ")[2] for s in recording.spans if s.kind == "injected"]
        first = next((one.partition(",")[0] for one in targets if "." in one), "")
        beside = views.TimeSeriesView(origin=f"/messages/{first.replace('.', '/')}", name=first)
        test = views.TimeSeriesView(origin="/curves/fdi-statistic", name="the monitor's test")
        above = [views.MapView(origin="/map"), views.Spatial3DView(origin="/space")]
        below = [beside, test, views.StateTimelineView(origin="/timeline")]
        stream.send_blueprint(
            views.Blueprint(views.Vertical(views.Horizontal(*above), *below), collapse_panels=True)
        )
