"""Tracks of a flight: local tracks, uncertainty, and the receiver's sky plot."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.recordings.flight_logs.ulog import read_ulog
from analysis.report.curves.recording import (
    FlightData,
    GroundTrack,
    Message,
    Signal,
    local_track,
)
from analysis.report.export_tracks import export_tracks
from analysis.report.page.log_sky import sky_pictures
from analysis.report.page.page_model import tracks_in_flight
from analysis.report.page.uncertainty import track_sigma
from analysis.report.recordings.from_autopilot_log import recording_of_log
from analysis.report.recordings.from_tlog import recording_of_tlog

T = np.arange(5.0)
GPS = GroundTrack("GPS", T, 47.0 + T * 1e-5, 8.0 + T * 0, 500.0 + T)
LOCAL = local_track("local estimate", T, T, 2.0 * T, -T)


def test_a_local_track_is_drawn_only_without_global_ones(tmp_path: Path) -> None:
    both = FlightData("flight", tracks=[LOCAL, GPS])
    assert [track.name for track in tracks_in_flight(both)] == ["GPS"]
    assert [track.name for track in tracks_in_flight(replace(both, tracks=[LOCAL]))] == [
        "local estimate"
    ]
    lines = json.loads(export_tracks(both, tmp_path, "geojson").read_text())["features"]
    assert [line["properties"]["name"] for line in lines] == ["GPS"]


def test_metres_of_a_local_track_are_metres_on_the_map() -> None:
    radius_m = 6_371_000.0
    assert np.radians(LOCAL.lat_deg) * radius_m == pytest.approx(T, rel=2e-3)
    assert np.radians(LOCAL.lon_deg) * radius_m == pytest.approx(2.0 * T, rel=2e-3)
    assert LOCAL.alt_m == pytest.approx(T)
    assert not LOCAL.select(T > 1).on_earth


def test_a_real_indoor_flight_has_a_local_track(shared_data: Path) -> None:
    found = recording_of_log(read_ulog(shared_data / "ulog" / "gps_interference.ulg"), "indoors")
    (track,) = tracks_in_flight(found)
    # Its setpoint went from 0, 0.15 to 1, 1 m and back.
    assert not track.on_earth
    assert np.ptp(np.radians(track.lat_deg) * 6_371_000.0) == pytest.approx(1.3, abs=0.1)
    # The receiver, which had no fix, gave 2^32 mm for its accuracy.
    assert not [s.name for s in found.of("gps-accuracy") if s.name != "speed, m/s"]
    sigma = track_sigma(track, found)
    assert sigma is not None
    assert np.nanmedian(sigma[0]) == pytest.approx(0.019 / np.sqrt(2.0), abs=1e-3)


def test_a_tlog_without_a_global_position_has_a_local_track() -> None:
    rows = np.zeros(4, [("t_us", "i8"), ("system", "u1"), ("component", "u1"), ("seq", "u1"),
                        ("time_boot_ms", "u4"), ("x", "f4"), ("y", "f4"), ("z", "f4")])  # fmt: skip
    rows["t_us"], rows["system"] = np.arange(4) * 1_000_000, 1
    rows["time_boot_ms"], rows["x"], rows["z"] = np.arange(4) * 1000, np.arange(4), -3.0
    (track,) = recording_of_tlog({"LOCAL_POSITION_NED": rows}, name="indoors").tracks
    assert not track.on_earth
    assert track.alt_m == pytest.approx([3.0] * 4)


@pytest.mark.parametrize(
    ("track", "signal", "sigma"),
    [
        ("GPS", ("gps-accuracy", "horizontal"), 1.0),
        ("GPS 2", ("gps-accuracy", "horizontal 2"), 1.0),
        ("GPS 2", ("gps-accuracy", "horizontal"), None),
        ("estimate", ("accuracy", "horizontal"), 1.0),
        ("truth", ("accuracy", "horizontal"), None),
    ],
)
def test_a_track_has_the_accuracy_of_its_own_source(
    track: str, signal: tuple[str, str], sigma: float | None
) -> None:
    accuracy = Signal(*signal, T + 0.5, np.full(5, np.sqrt(2.0)))
    found = track_sigma(GPS._replace(name=track), FlightData("", signals=[accuracy]))
    if sigma is None:
        assert found is None
    else:
        assert found is not None
        # NaN before the first accuracy.
        assert np.isnan(found[0][0])
        assert found[0][1:] == pytest.approx([sigma] * 4)


def test_the_fused_solution_has_a_sigma_per_axis() -> None:
    signals = [Signal("fused-sigma", axis, T, np.full(5, value)) for axis, value in
               (("north", 1.0), ("east", 3.0))]  # fmt: skip
    found = track_sigma(GPS._replace(name="fused"), FlightData("", signals=signals))
    assert found is not None
    assert (found[0][0], found[1][0]) == (1.0, 3.0)


def _info(**columns: Any) -> FlightData:
    shaped = {name: np.asarray(value) for name, value in columns.items()}
    message = "GPS_STATUS" if "satellite_prn" in columns else "satellite_info"
    return FlightData("", messages={message: Message(np.zeros(1), shaped)})


def test_a_ulog_and_a_tlog_give_the_same_sky_plot() -> None:
    ulog = {"svid": [5, 211, 0], "used": [1, 0, 0], "elevation": [40, 20, 0],
            "azimuth": [128, 64, 0]}  # fmt: skip
    spread = {f"{name}[{i}]": [v] for name, row in ulog.items() for i, v in enumerate(row)}
    tlog = {"prn" if name == "svid" else name: [row] for name, row in ulog.items()}
    ((_, one),) = sky_pictures(_info(**spread))
    ((_, other),) = sky_pictures(_info(**{f"satellite_{name}": row for name, row in tlog.items()}))
    assert one == other
    # An empty entry has no name; 211 is u-blox's first Galileo satellite.
    assert b"<!-- G05 -->" in one
    assert b"<!-- E01 -->" in one
    assert one.count(b"<!-- G") == 1


def test_a_log_without_satellite_directions_has_no_sky_plot() -> None:
    assert sky_pictures(FlightData("")) == []
    assert sky_pictures(_info(svid=[5])) == []
    empty = {f"{name}[0]": [0] for name in ("svid", "used", "elevation", "azimuth")}
    assert sky_pictures(_info(**empty)) == []
