"""Tracks for maps: what is written is read back by what the formats say."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from analysis.report.curves.recording import FlightData, GroundTrack, Span
from analysis.report.export_tracks import export_tracks

KML = "{http://www.opengis.net/kml/2.2}"


def recording() -> FlightData:
    t_s = np.arange(5.0)
    track = GroundTrack("GPS", t_s, 47 + t_s * 1e-5, 8 + t_s * 2e-5, 500 + t_s)
    span = Span("injected: jump", 1.0, 3.0, "bias", "injected")
    return FlightData("a & b", tracks=[track], spans=[span])


def test_kml_holds_the_track_and_its_part_during_the_fault(tmp_path: Path) -> None:
    root = ET.parse(export_tracks(recording(), tmp_path, "kml")).getroot()
    marks = root.findall(f".//{KML}Placemark")
    assert [mark.findtext(f"{KML}name") for mark in marks] == ["GPS", "jump on GPS"]
    places = [mark.findtext(f".//{KML}coordinates", "").split() for mark in marks]
    assert places[0][2] == "8.0000400,47.0000200,502.00"
    assert len(places[1]) == 3


def test_geojson_holds_longitude_first_and_the_times(tmp_path: Path) -> None:
    found = json.loads(export_tracks(recording(), tmp_path, "geojson").read_text())
    track, stretch = found["features"]
    assert track["geometry"]["coordinates"][1] == pytest.approx([8.00002, 47.00001, 501.0])
    assert stretch["properties"]["times_s"] == [1, 2, 3]
