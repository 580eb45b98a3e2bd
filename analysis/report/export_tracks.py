"""Export tracks to KML (Google Earth, QGroundControl) and GeoJSON, faults as separate lines."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from analysis.report.curves.recording import FlightData, GroundTrack
from analysis.report.page.series_colours import PALETTE, series_colours

FORMS = ("kml", "geojson")
# Chosen: longer lines make map programs slow.
POINTS = 20_000  # per track, at most


def export_tracks(recording: FlightData, folder: Path, form: str) -> Path:
    """Write `tracks.kml` or `tracks.geojson` to `folder`; returns the path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"tracks.{form}"
    lines = list(_lines(recording))
    if form == "kml":
        _write_kml(path, recording.name, lines)
    else:
        _write_geojson(path, lines)
    return path


def _lines(recording: FlightData) -> Iterator[tuple[str, str, GroundTrack]]:
    """Name, colour and positions of each track, then of its parts during each fault."""
    tracks = [track for track in recording.tracks if track.on_earth]
    colours = series_colours([track.name for track in tracks])
    for track, colour in zip(tracks, colours, strict=True):
        yield track.name, PALETTE[colour], _thin(track)
    for span in recording.spans:
        if span.kind != "injected":
            continue
        for track in tracks:
            inside = (track.t_s >= span.start_s) & (track.t_s <= span.end_s)
            # A line needs two points.
            if inside.sum() > 1:
                name = f"{span.lane.removeprefix('injected: ')} on {track.name}"
                yield name, PALETTE[1], _thin(track.select(inside))


def _thin(track: GroundTrack) -> GroundTrack:
    # Rounded up, so that the thinned track never exceeds POINTS.
    step = -(-len(track.t_s) // POINTS)
    return track.select(slice(None, None, step))


def _write_kml(path: Path, name: str, lines: list[tuple[str, str, GroundTrack]]) -> None:
    """KML 2.3 (OGC 12-007r2); a colour is alpha, blue, green, red."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = name
    for label, colour, track in lines:
        mark = ET.SubElement(document, "Placemark")
        ET.SubElement(mark, "name").text = label
        style = ET.SubElement(ET.SubElement(mark, "Style"), "LineStyle")
        red, green, blue = colour[1:3], colour[3:5], colour[5:7]
        # ff: opaque. KML's byte order is the reverse of CSS's `#rrggbb`.
        ET.SubElement(style, "color").text = f"ff{blue}{green}{red}"
        ET.SubElement(style, "width").text = "3"
        line = ET.SubElement(mark, "LineString")
        # Heights are above mean sea level; the default clamps the line to the ground.
        ET.SubElement(line, "altitudeMode").text = "absolute"
        ET.SubElement(line, "coordinates").text = " ".join(
            # 1e-7 degree is MAVLink's resolution, about a centimetre.
            f"{lon:.7f},{lat:.7f},{alt:.2f}"
            for lon, lat, alt in _places(track)
        )
    ET.indent(root)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _write_geojson(path: Path, lines: list[tuple[str, str, GroundTrack]]) -> None:
    """GeoJSON (RFC 7946), one LineString per line; `times_s` are the times of its points."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": label, "stroke": colour, "times_s": track.t_s.round(3).tolist()},
            "geometry": {"type": "LineString", "coordinates": _places(track)},
        }
        for label, colour, track in lines
    ]
    collection = {"type": "FeatureCollection", "features": features}
    path.write_text(json.dumps(collection, ensure_ascii=False), encoding="utf-8")


def _places(track: GroundTrack) -> list[list[float]]:
    """Longitude, latitude and height of each point; an unknown height is zero."""
    # JSON has no NaN, and all points of a line need three values.
    alt_m = np.nan_to_num(track.alt_m).round(2)
    columns = (track.lon_deg.round(7), track.lat_deg.round(7), alt_m)
    places: list[list[float]] = np.column_stack(columns).tolist()
    return places
