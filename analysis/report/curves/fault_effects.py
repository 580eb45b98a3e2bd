"""Effects of faults: truth and estimates of a run compared with its fault-free reference flight.

Both ran the same scenario with the same seed, so the deviations are zero before the first fault,
but for those of an autopilot, whose flights differ a little without a fault too. A fault's effect
is evaluated until the next fault, or until `RECOVERY_S` after its end.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.report.curves.recording import Signal, Vector
from analysis.results import AttitudeError, Decision, read_results
from analysis.scoring.outcome import RECOVERY_S
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import read_columns

TRUTH = "HIL_STATE_QUATERNION"
LAST_S = 1.0  # the lasting effect is the median of this last part of the evaluated time
PANELS = {"position_m": "twin-position", "speed_mps": "twin-speed", "attitude_deg": "twin-attitude"}

# Attitude results hold only the estimate's error, so the change of the error is shown
ESTIMATE_OF = {"twin-position": "estimate", "twin-attitude": "error of the estimate"}


class StampedValues(NamedTuple):
    """Timestamps (n,) and values (n, k)."""

    t_us: Vector
    values: Vector


def deviation_curves(folder: Path, reference: Path, t0_us: int, later_us: int = 0) -> list[Signal]:
    """Deviation of truth and estimates of a run folder from those of the reference flight, which
    took off `later_us` earlier."""
    found = []
    own, clean = _truth(folder), _truth(reference, later_us)
    if own is not None and clean is not None:
        t_s, ours, theirs = _common(own, clean, t0_us)
        apart = ours - theirs
        # q and -q are the same attitude.
        dot = np.abs(np.einsum("ni,ni->n", ours[:, 6:10], theirs[:, 6:10]))
        angle = np.degrees(2 * np.arccos(np.clip(dot, 0.0, 1.0)))
        found += [
            Signal("twin-position", "truth", t_s, np.linalg.norm(apart[:, :3], axis=1)),
            Signal("twin-speed", "truth", t_s, np.linalg.norm(apart[:, 3:6], axis=1)),
            Signal("twin-attitude", "truth", t_s, angle),
        ]
    ours_, theirs_ = _estimates(folder), _estimates(reference, later_us)
    for panel, track in ours_.items():
        if panel in theirs_:
            t_s, values, clean_values = _common(track, theirs_[panel], t0_us)
            off = np.linalg.norm(values - clean_values, axis=1)
            found.append(Signal(panel, ESTIMATE_OF[panel], t_s, off))
    return found


def measure_effects(
    curves: Sequence[Signal], labels: Sequence[Label], t0_us: int
) -> list[dict[str, Any]]:
    """Largest and lasting deviation of each curve by fault; the axis starts at `t0_us`."""
    starts_s = [(label.start_us - t0_us) * 1e-6 for label in labels]
    rows = []
    for label, start_s in zip(labels, starts_s, strict=True):
        end_s = np.inf if label.end_us is None else (label.end_us - t0_us) * 1e-6 + RECOVERY_S
        # Until the next fault: the effects of overlapping faults cannot be separated.
        end_s = min([end_s, *(other for other in starts_s if other > start_s)])
        row: dict[str, Any] = {"id": label.id}
        for key, panel in PANELS.items():
            for curve in curves:
                inside = (curve.t_s >= start_s) & (curve.t_s <= end_s)
                if curve.panel == panel and inside.any():
                    row.setdefault(key, {})[curve.name] = _extent(curve, inside)
        rows.append(row)
    return rows


def _extent(curve: Signal, inside: np.typing.NDArray[np.bool_]) -> Mapping[str, float]:
    t_s, value = curve.t_s[inside], curve.value[inside]
    # The median, as a single sample may be noise.
    last = value[t_s >= t_s[-1] - LAST_S]
    return {"most": round(float(value.max()), 3), "lasting": round(float(np.median(last)), 3)}


def _common(own: StampedValues, clean: StampedValues, t0_us: int) -> tuple[Vector, Vector, Vector]:
    """Times on the report's axis with both values, and the values of both."""
    both = (own.t_us >= clean.t_us[0]) & (own.t_us <= clean.t_us[-1])
    stamps = own.t_us[both]
    theirs = [np.interp(stamps, clean.t_us, column) for column in clean.values.T]
    return (stamps - t0_us) * 1e-6, own.values[both], np.stack(theirs, axis=1)


def _truth(folder: Path, later_us: int = 0) -> StampedValues | None:
    """True ECEF position, velocity and attitude, from the log before fault injection."""
    # The truth in `sent.tlog` may be modified by faults.
    rows = read_columns(folder / "received.tlog", only={TRUTH}).get(TRUTH)
    if rows is None:
        return None
    lat, lon = np.radians(rows["lat"] * 1e-7), np.radians(rows["lon"] * 1e-7)
    place = ecef_from_geodetic(lat, lon, rows["alt"] * 1e-3)
    v_ned = np.stack([rows[name] * 1e-2 for name in ("vx", "vy", "vz")], axis=1)
    values = np.hstack([place, v_ned, rows["attitude_quaternion"]])
    return StampedValues(rows["time_usec"].astype(np.float64) + later_us, values)


def _estimates(folder: Path, later_us: int = 0) -> dict[str, StampedValues]:
    """The monitor's position, and attitude errors of the first estimator, by panel."""
    found: dict[str, list[tuple[int, tuple[float, ...]]]] = {}
    first = ""
    for result in read_results(folder / "results.jsonl"):
        t_us = result.t_us + later_us
        if isinstance(result, Decision) and result.position_ecef_m is not None:
            found.setdefault("twin-position", []).append((t_us, result.position_ecef_m))
        elif isinstance(result, AttitudeError):
            first = first or result.estimator
            if result.estimator == first:
                found.setdefault("twin-attitude", []).append((t_us, (result.angle,)))
    # Without results there is no curve.
    return {panel: StampedValues(*map(np.array, zip(*rows, strict=True)))
            for panel, rows in sorted(found.items(), reverse=True)}  # fmt: skip
