"""A flight in Foxglove's own schemas [1]_, for the panels Map, 3D and Log.

Positions are LocationFix; attitudes are FrameTransform and PoseInFrame, from `map` (east, north, up
at the start) to the body (forward, left, up); events and faults are Log.

.. [1] https://docs.foxglove.dev/docs/visualization/message-schemas
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import FlightData, GroundTrack
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler

RATE_HZ = 50.0  # of an attitude, at most: a screen shows no more
MAP = "map"
Vector = NDArray[np.float64]


def write_views(recording: FlightData, context: Any) -> None:
    """Log positions, attitudes and events to a Foxglove context."""
    channels = import_extra("foxglove.channels")
    messages = import_extra("foxglove.messages")

    def times_of(t_s: Vector) -> Iterator[tuple[dict[str, Any], int]]:
        """Yield what a message and its log need of each time."""
        t_us = (recording.t0_us + np.round(t_s * 1e6)).astype(np.int64).clip(0)
        for each_us in t_us.tolist():
            s, us = divmod(each_us, 1_000_000)
            yield {"timestamp": messages.Timestamp(s, us * 1000)}, each_us * 1000

    tracks = {track.name: track for track in recording.tracks if track.on_earth}
    for name, track in tracks.items():
        channel = channels.LocationFixChannel(f"/position/{topic_name(name)}", context=context)
        columns = (track.lat_deg, track.lon_deg, np.nan_to_num(track.alt_m))
        for (at, t_ns), place in zip(times_of(track.t_s), zip(*columns, strict=True), strict=True):
            lat, lon, alt = map(float, place)
            fix = messages.LocationFix(
                latitude=lat, longitude=lon, altitude=alt, frame_id=name, **at
            )
            channel.log(fix, log_time=t_ns)
    transforms = channels.FrameTransformChannel("/transforms", context=context)
    for name, t_s, q, place_m in attitudes(recording, tracks):
        channel = channels.PoseInFrameChannel(f"/pose/{topic_name(name)}", context=context)
        rows = zip(times_of(t_s), q.tolist(), place_m.tolist(), strict=True)
        for (at, t_ns), (w, x, y, z), (east, north, up) in rows:
            turn = messages.Quaternion(x=x, y=y, z=z, w=w)
            place = messages.Vector3(x=east, y=north, z=up)
            transform = messages.FrameTransform(
                parent_frame_id=MAP, child_frame_id=name, translation=place, rotation=turn, **at
            )
            transforms.log(transform, log_time=t_ns)
            pose = messages.Pose(position=place, orientation=turn)
            channel.log(messages.PoseInFrame(frame_id=MAP, pose=pose, **at), log_time=t_ns)
    channel = channels.LogChannel("/log", context=context)
    levels = messages.LogLevel
    grades = [levels.Error] * 4 + [levels.Warning] + [levels.Info] * 3  # by MAVLink's severity
    times = times_of(np.array([event.t_s for event in recording.events]))
    for (at, t_ns), event in zip(times, recording.events, strict=True):
        level = grades[min(event.severity, 7)]
        log = messages.Log(level=level, message=event.text, name=event.kind, **at)
        channel.log(log, log_time=t_ns)


def attitudes(
    recording: FlightData, tracks: dict[str, GroundTrack]
) -> Iterator[tuple[str, Vector, Vector, Vector]]:
    """Yield name, times (n,), quaternions (n, 4) and places (n, 3) of each source of attitude."""
    first = next(iter(tracks.values()), None)
    signals = [{s.name: s for s in recording.of(axis)} for axis in ("roll", "pitch", "yaw")]
    for name in signals[0].keys() & signals[1].keys() & signals[2].keys():
        roll, pitch, yaw = (np.deg2rad(found[name].value) for found in signals)
        t_s = signals[0][name].t_s
        if not len(roll) == len(pitch) == len(yaw):
            continue
        rows = np.flatnonzero(np.diff(np.floor(t_s * RATE_HZ), prepend=-1.0))
        # From north, east, down to east, north, up, and from right, down to left, up.
        q = quat_from_euler(roll[rows], -pitch[rows], 0.5 * np.pi - yaw[rows])
        rows = rows[keep := np.isfinite(q).all(axis=1)]
        track = tracks.get(name, tracks.get("estimate", first))
        place_m = (
            np.zeros((len(rows), 3))
            if track is None or first is None
            else local_places(track, first, t_s[rows])
        )
        yield name, t_s[rows], q[keep], place_m


def local_places(track: GroundTrack, origin: GroundTrack, t_s: Vector) -> Vector:
    """Return metres east, north and up of the start of `origin`, (n, 3) at the times `t_s` (n,)."""
    north, east = track.metres_from(float(origin.lat_deg[0]), float(origin.lon_deg[0]))
    up = np.nan_to_num(track.alt_m) - np.nan_to_num(origin.alt_m[0])
    return np.column_stack([np.interp(t_s, track.t_s, axis) for axis in (east, north, up)])


def topic_name(name: str) -> str:
    """Return a name as a part of a topic."""
    return name.lower().replace(" ", "_")
