"""Evidence of a flight under an autopilot, from its run folder.

Times count from take-off, as in the schedule, since the time until take-off varies by seconds.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flying.flight_evidence import PATH, Evidence, EvidenceCurve, attitude_curve
from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.vehicle_record import vehicle_outcome
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.results import read_results
from analysis.scoring.attitude_scoring import AUTOPILOTS
from analysis.scoring.vehicle_outcome import BAD_ENDS, DEGRADED, VehicleEvent, outcome_rank
from mavproxy_fault.numerics.earth import curvature_radii
from mavproxy_fault.numerics.rotations.rotation import wrap_angles
from mavproxy_fault.wire.tlog import Columns, read_columns

WARNING = 4  # MAV_SEVERITY
TRACK_HZ = 10.0
LogRows = NDArray[Any]


def collect_evidence(folder: Path) -> tuple[Evidence, float]:
    """Return curves and marks of a flight that took off, and its duration since take-off [s]."""
    summary = json.loads((folder / "summary.json").read_text())["autopilot"]
    columns = read_columns(folder / "sent.tlog")
    truth = columns["HIL_STATE_QUATERNION"]
    # The log has another clock; the truth's own timestamps give the offset.
    shift_us = int(truth["t_us"][0]) - int(truth["time_usec"][0])
    off_ground_s = summary["moments_s"]["take-off"]
    begin_us = round(off_ground_s * 1e6)

    def since(stamps_us: LogRows) -> NDArray[np.float64]:
        return (stamps_us - shift_us) * 1e-6 - float(off_ground_s)

    errors = (one for one in read_results(folder / "results.jsonl") if one.t_us >= begin_us)
    curves = attitude_curve(errors, AUTOPILOTS, begin_us) | path_curves(truth, since)
    marks = vehicle_marks(columns, begin_us) + text_marks(columns, since)
    if summary["ended_early"]:
        end_s = float(since(truth["t_us"][-1:])[0])
        marks.append(VehicleEvent(end_s, "lost", summary["ended_early"]))
    landing_s = summary["moments_s"].get("landing", math.inf) - float(off_ground_s)
    marks = sorted(
        (mark for mark in marks if belongs_to_flight(mark, landing_s)), key=lambda mark: mark.t_s
    )
    return Evidence(curves, marks), float(since(truth["t_us"][-1:])[0])


def belongs_to_flight(mark: VehicleEvent, landing_s: float) -> bool:
    """Whether a mark counts: between take-off and the landing command, or a bad end.

    Modes and flags during the landing depend on the touchdown, whose time varies between flights.
    """
    return mark.t_s >= 0.0 and (mark.t_s < landing_s or mark.kind in ("lost", *BAD_ENDS))


def path_curves(truth: LogRows, since: Any) -> dict[str, EvidenceCurve]:
    """Return the true path [m] north, east and up of the first position; `truth` are the rows (n,)
    of HIL_STATE_QUATERNION."""
    # About 10 Hz, since thousands of flights are stored.
    every = max(1, round(_rate_hz(truth) / TRACK_HZ))
    t_s = since(truth["t_us"])[::every]
    airborne = t_s >= 0.0
    lat, lon = (np.radians(truth[name][::every] * 1e-7) for name in ("lat", "lon"))
    meridian_m, normal_m = curvature_radii(float(lat[0]))
    axes = (
        (lat - lat[0]) * meridian_m,
        wrap_angles(lon - lon[0]) * normal_m * np.cos(lat[0]),
        (truth["alt"][::every] - truth["alt"][0]) * 1e-3,
    )
    times = t_s[airborne].round(3).tolist()
    return {
        name: EvidenceCurve(times, values[airborne].round(3).tolist())
        for name, values in zip(PATH, axes, strict=True)
    }


def _rate_hz(rows: LogRows) -> float:
    stamps = rows["t_us"]
    return 1e6 * (len(stamps) - 1) / max(1.0, float(stamps[-1] - stamps[0]))


def vehicle_marks(columns: Columns, t0_us: int) -> list[VehicleEvent]:
    """What happened to the vehicle, by seconds from `t0_us`, as in the summary of the run."""
    found = vehicle_outcome(add_derived_curves(recording_of_tlog(columns, t0_us=t0_us)))
    return [one for one in found.events if outcome_rank(one.kind) > outcome_rank(DEGRADED)]


def text_marks(columns: Columns, since: Any) -> list[VehicleEvent]:
    """Return a mark for each warning of the autopilot and each change of its estimator flags."""
    marks = []
    if "STATUSTEXT" in columns:
        rows = columns["STATUSTEXT"]
        rows = rows[(rows["severity"] <= WARNING) & (rows["component"] == 1)]
        for t_s, text in zip(since(rows["t_us"]).tolist(), rows["text"], strict=True):
            message = bytes(text).split(b"\0")[0].decode("utf-8", "replace")
            marks.append(VehicleEvent(round(t_s, 3), "detected", message))
    for name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
        if name in columns:
            # Each value is compared with the previous one.
            rows = columns[name]
            changed = np.flatnonzero(np.diff(rows["flags"].astype(np.int64))) + 1
            for t_s, flags in zip(
                since(rows["t_us"])[changed].tolist(), rows["flags"][changed], strict=True
            ):
                marks.append(
                    VehicleEvent(round(t_s, 3), "detected", f"{name} flags {int(flags):#x}")
                )
    return marks
