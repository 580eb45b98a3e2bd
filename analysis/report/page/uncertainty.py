"""Uncertainty of the positions of a track, from the accuracy in its log."""

import numpy as np

from analysis.report.curves.recording import FlightData, GroundTrack, Signal, Vector

# Panel with the accuracy of a track, by the beginning of the track's name.
PANELS_OF = (("GPS", "gps-accuracy"), ("estimate", "accuracy"), ("local estimate", "accuracy"))
FUSED, FUSED_PANEL = "fused", "fused-sigma"


def track_sigma(track: GroundTrack, recording: FlightData) -> tuple[Vector, Vector] | None:
    """Sigmas north and east (n,) of a track (n,), m; None if unknown.

    A horizontal accuracy is taken as the root of the summed variances of both axes, as PX4's `eph`,
    so each axis has half the variance.
    """
    if track.name == FUSED:
        north, east = (recording.curve(FUSED_PANEL, axis) for axis in ("north", "east"))
        return (_at(track, north), _at(track, east)) if north and east else None
    for name, panel in PANELS_OF:
        # The second receiver is "GPS 2", with the accuracy "horizontal 2".
        signal = recording.curve(panel, f"horizontal{track.name.removeprefix(name)}")
        if track.name.startswith(name) and signal is not None:
            each = _at(track, signal) / np.sqrt(2.0)
            return each, each
    return None


def _at(track: GroundTrack, signal: Signal) -> Vector:
    """The last value before each time of the track; NaN before the first."""
    place = np.searchsorted(signal.t_s, track.t_s, side="right") - 1
    found: Vector = np.where(place >= 0, signal.value[np.maximum(place, 0)], np.nan)
    return found
