"""A report's recording for Rerun, read by Rerun's own reader (`pip install rerun-sdk`)."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.report.recordings.flight_sources import read_flight
from mavproxy_fault.cli import main
from mavproxy_fault.wire import tlog

chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed (170 MB)")


def test_rerun_reads_track_attitude_and_messages(
    flight: Callable[..., Path], tmp_path: Path
) -> None:
    path, out = flight(), tmp_path / "out"
    main(["report", str(path), "--export", "rerun", "--out", str(out)])
    found = {}
    for part in chunk.RrdReader(out / "export" / "flight.rrd").stream():
        found.setdefault(part.entity_path, []).append(part.to_record_batch().to_pydict())
    rows = tlog.read_columns(path)["ATTITUDE"]
    (sent,) = found["/messages/ATTITUDE/time_boot_ms/log"]
    assert np.ravel(sent["Scalars:scalars"]).tolist() == rows["time_boot_ms"].tolist()
    (yaw,) = found["/messages/ATTITUDE/yaw/log"]  # constant: once
    assert yaw["Scalars:scalars"] == [[rows["yaw"][0]]]
    recording = read_flight([path], ()).recording
    track = recording.tracks[0]
    (places,) = found[f"/map/{track.name}/now"]
    assert np.array(places["GeoPoints:positions"])[:, 0, 0].tolist() == track.lat_deg.tolist()
    (turns,) = (p for p in found["/space/ATTITUDE/body"] if "Transform3D:quaternion" in p)
    _, _, z, w = turns["Transform3D:quaternion"][0][0]
    # Level: the nose points east at a yaw of 90 degrees, where the viewer counts from.
    east_deg = 90 - recording.of("yaw")[0].value[0]
    assert 2 * np.rad2deg(np.arctan2(z, w)) == pytest.approx(east_deg, abs=5)
    lane = recording.spans[0]
    (states,) = found[f"/timeline/{lane.lane}"]
    assert states["StateChange:state"][0] == [lane.text]
