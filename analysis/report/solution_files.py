"""Write positions as RTKLIB position files, NMEA sentences, and tracks for maps."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.report.curves.recording import FlightData
from analysis.report.export_tracks import FORMS, export_tracks
from analysis.report.nmea_file import write_nmea
from analysis.report.solution_row import SolutionRow, row_of
from analysis.results import Decision, FusedState, Result

SINGLE, FUSED = 5, 1  # RTKLIB's quality Q: single point; the fused solution is marked as fix
HEAD = (
    "% program   : mavproxy-fault\n"
    "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
    "ns=# of satellites)\n"
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)"
    "   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)


def write_solution(folder: Path, results: Sequence[Result], recording: FlightData) -> None:
    """Write `solution` and, if present, `fused` as .pos and .nmea; and `tracks.kml`, `.geojson`."""
    decisions = [r for r in results if isinstance(r, Decision) and r.position_ecef_m]
    _write_both(folder / "solution", [row_of(state) for state in decisions], SINGLE)
    fused = [r for r in results if isinstance(r, FusedState) and r.name == "fused"]
    if fused:
        _write_both(folder / "fused", [row_of(state) for state in fused], FUSED)
    for form in FORMS:
        export_tracks(recording, folder, form)


def _write_both(path: Path, rows: Sequence[SolutionRow], quality: int) -> None:
    with path.with_suffix(".pos").open("w", encoding="ascii") as file:
        file.write(HEAD)
        file.writelines(_line(row, quality) for row in rows)
    write_nmea(path.with_suffix(".nmea"), rows)


def _line(row: SolutionRow, quality: int) -> str:
    time = row.gps_time
    north, east, down = row.sigma_ned_m or (0.0, 0.0, 0.0)
    between = np.zeros((3, 3)) if row.covariance_ned_m2 is None else row.covariance_ned_m2
    # RTKLIB's form: the root of a covariance, with its sign.
    signed = (np.sign(between) * np.sqrt(np.abs(between))).tolist()
    north_east, east_up, up_north = signed[0][1], -signed[1][2], -signed[2][0]
    return (
        f"{time:%Y/%m/%d %H:%M:%S}.{time.microsecond // 1000:03d} {row.lat_deg:14.9f}"
        f" {row.lon_deg:14.9f} {row.height_m:10.4f} {quality:3d} {len(row.satellites):3d}"
        f" {north:8.4f} {east:8.4f} {down:8.4f}"
        f" {north_east:8.4f} {east_up:8.4f} {up_north:8.4f}   0.00    0.0\n"
    )
