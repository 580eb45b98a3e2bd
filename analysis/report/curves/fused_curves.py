"""Error curves of the fused solutions against the truth, with their 3-sigma bounds."""

import numpy as np

from analysis.report.curves.recording import FlightData, GroundTrack, Signal, Vector

AXES = ("north", "east", "down")
FUSED = "fused"  # tracks of fused solutions begin with this
BAND = 3.0  # sigmas: 99.7 % of normally distributed errors


def fused_errors(recording: FlightData) -> list[Signal]:
    """Errors of every fused track along each axis, and the 3-sigma bound of the fused solution."""
    found: list[Signal] = []
    errors = solution_errors(recording)
    for i, axis in enumerate(AXES if errors else ()):
        panel = f"fused-{axis}"
        found += [Signal(panel, name, t_s, error[:, i]) for name, t_s, error in errors]
        # Bounds on both sides show whether the errors agree with the sigmas.
        if sigma := recording.curve("fused-sigma", axis):
            found.append(Signal(panel, "+3 sigma", sigma.t_s, BAND * sigma.value))
            found.append(Signal(panel, "-3 sigma", sigma.t_s, -BAND * sigma.value))
    return found


def solution_errors(recording: FlightData) -> list[tuple[str, Vector, Vector]]:
    """Name, times (n,) and errors (n, 3) of each fused solution; none without the truth."""
    truth = recording.track("truth")
    tracks = [track for track in recording.tracks if track.name.startswith(FUSED)]
    return [] if truth is None else [(t.name, *error_ned_m(t, truth)) for t in tracks]


def error_ned_m(track: GroundTrack, truth: GroundTrack) -> tuple[Vector, Vector]:
    """Times (n,) covered by the truth, and errors of the track (n, 3) north, east, down in m."""
    inside = (track.t_s >= truth.t_s[0]) & (track.t_s <= truth.t_s[-1])
    t_s = track.t_s[inside]
    lat, lon, alt = (
        np.interp(t_s, truth.t_s, true)
        for true in (truth.lat_deg, np.unwrap(truth.lon_deg, period=360), truth.alt_m)
    )
    own = track.select(inside)
    # Down is the negative height error.
    return t_s, np.column_stack((*own.metres_from(lat, lon), alt - own.alt_m))
