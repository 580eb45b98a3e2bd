"""Positions for other programs: RTKLIB's position file, and tracks for maps."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from analysis.report.export_tracks import FORMS, export_tracks
from analysis.report.recordings.recording import Recording
from analysis.results import Decision, FusedState, Result
from mavproxy_fault.numerics.earth import geodetic_from_ecef
from mavproxy_fault.numerics.earth_kernel import geodetic, ned_axes

GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
SINGLE, FUSED = 5, 1  # RTKLIB's Q: single point; the fused one is the best there is
HEAD = (
    "% program   : mavproxy-fault\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
    "ns=# of satellites)\n"
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)"
    "   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)


def write_solution(folder: Path, results: Sequence[Result], recording: Recording) -> None:
    """`solution.pos`, `fused.pos` where there is a fused one, `tracks.kml` and `.geojson`."""
    decisions = [r for r in results if isinstance(r, Decision) and r.position_ecef_m]
    _write_pos(folder / "solution.pos", decisions)
    fused = [r for r in results if isinstance(r, FusedState) and r.name == "fused"]
    if fused:
        _write_pos(folder / "fused.pos", fused)
    for form in FORMS:
        export_tracks(recording, folder, form)


def _write_pos(path: Path, states: Iterable[Decision | FusedState]) -> None:
    with path.open("w", encoding="ascii") as file:
        file.write(HEAD)
        for state in states:
            file.write(_line(state))


def _line(state: Decision | FusedState) -> str:
    time = GPS_ZERO + timedelta(microseconds=state.t_us)
    r_ecef_m = state.position_ecef_m
    assert r_ecef_m is not None
    lat, lon, height = (float(x) for x in geodetic_from_ecef(r_ecef_m))
    if isinstance(state, FusedState):
        quality, count = FUSED, sum(w > 0.0 and n[1:].isdigit() for n, w in state.weights.items())
        north, east, down = state.position_sigma_m
    else:
        quality, count = SINGLE, len(set(state.satellites) - set(state.excluded))
        axes = ned_axes(*geodetic(np.array(r_ecef_m))[:2])
        variance = np.square(state.position_sigma_m or (0.0, 0.0, 0.0))
        north, east, down = np.sqrt(axes**2 @ variance)  # without what correlates the axes
    return (
        f"{time:%Y/%m/%d %H:%M:%S}.{time.microsecond // 1000:03d} {np.degrees(lat):14.9f}"
        f" {np.degrees(lon):14.9f} {height:10.4f} {quality:3d} {count:3d} {north:8.4f}"
        f" {east:8.4f} {down:8.4f}   0.0000   0.0000   0.0000   0.00    0.0\n"
    )
