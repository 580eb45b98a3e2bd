"""What the fused position is worth: after isolation, without it, with GTSAM's robust losses.

Run by hand: `python benchmarks/fusion.py flight DIR` on the folder of a `mavproxy-fault run` (its
received.tlog is the flight without faults, its sent.tlog the one with them), `... walk DATA` on the
folder gnss_imu_walk (needs RTKLIB's rnx2rtkp), or `... time`.
"""

import math
import platform
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from analysis.epochs import Decoder
from analysis.fdi import DetectorConfig
from analysis.fdi.core import Core
from analysis.fusion.config import FusionConfig
from analysis.fusion.smoother import Fusion
from analysis.gnss import ned_axes
from analysis.recordings import read_rinex_samples
from analysis.reference import References
from analysis.results import Decision, FusedState, Result
from analysis.samples import Epoch, ImuSample, Sample, TruthSample, Vector
from mavproxy_fault.wire.tlog import read_frames
from simvehicle.earth import ecef_from_geodetic

Row = tuple[Sample, list[Result], Core]
Truths = dict[int, tuple[float, float, float]]
SETTINGS = {
    "isolated (default)": FusionConfig(),
    "no decisions": FusionConfig(decide=False),
    "no decisions, Huber": FusionConfig(decide=False, robust="huber"),
    "no decisions, Geman-McClure": FusionConfig(decide=False, robust="geman-mcclure"),
}
WALK_GEOID_M = 21.387  # of the folder's README: heights of the reference are above sea level
STEP_M, STEP_FROM_S, STEP_FOR_S = 50.0, 60.0, 30.0
TIMED_S = 20
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


def detected(samples: Iterable[Sample]) -> list[Row]:
    """Every sample with what the detector said, so that settings share its work."""
    references = References(DetectorConfig())
    state = references.new_state()
    rows = []
    for sample in samples:
        results, state = references.step(sample, state)
        rows.append((sample, results, state.detector.core))
    return rows


def fused(rows: list[Row], config: FusionConfig) -> list[FusedState]:
    """The fused states under one setting."""
    fusion = Fusion(config)
    state = fusion.new_state()
    found: list[FusedState] = []
    for sample, results, core in rows:
        said, state = fusion.step(sample, results, core, state)
        found += [r for r in said if isinstance(r, FusedState)]
    return found


def errors(states: Iterable[FusedState | Decision], truths: Truths) -> dict[int, Vector]:
    """Position error (3,) north, east, down by time."""
    found = {}
    for state in states:
        truth = truths.get(state.t_us)
        if truth is not None and state.position_ecef_m is not None:
            axes = ned_axes(truth[0], truth[1])
            found[state.t_us] = axes @ (
                np.array(state.position_ecef_m) - np.asarray(ecef_from_geodetic(*truth))
            )
    return found


def rmse(found: dict[int, Vector], skip_s: float = 10.0) -> float:
    """Root mean square of the error's length without the first seconds, in metres."""
    if not found:
        return math.nan
    first = min(found) + skip_s * 1e6
    return math.sqrt(float(np.mean([e @ e for t, e in found.items() if t >= first])))


def spread(found: dict[int, Vector], skip_s: float = 10.0) -> float:
    """The same about the mean error: what a constant offset, of the reference too, leaves."""
    first = min(found) + skip_s * 1e6
    late = np.array([e for t, e in found.items() if t >= first])
    return rmse({k: e for k, e in enumerate(late - late.mean(axis=0))}, 0.0)


def nees(states: list[FusedState], found: dict[int, Vector]) -> float:
    """Mean normalised squared position error; 3 where the sigmas are right."""
    each = [
        float(((found[s.t_us] / s.position_sigma_m) ** 2).sum()) for s in states if s.t_us in found
    ]
    return float(np.mean(each[len(each) // 8 :])) if each else math.nan


def decisions(rows: list[Row]) -> list[Decision]:
    """The detector's decisions."""
    return [r for _, results, _ in rows for r in results if isinstance(r, Decision)]


def tlog_samples(path: Path) -> list[Sample]:
    """The samples of a recording."""
    decoder = Decoder()
    return [sample for _, frame in read_frames(path) for sample in decoder.decode(frame)]


def flight(folder: Path) -> None:
    """The table of a simulated flight."""
    clean_samples = tlog_samples(folder / "received.tlog")
    truths = {
        s.t_us: (math.radians(s.lat_deg), math.radians(s.lon_deg), s.alt_m)
        for s in clean_samples
        if isinstance(s, TruthSample)
    }
    clean = detected(clean_samples)
    states = fused(clean, FusionConfig())
    found = errors(states, truths)
    best = rmse(found)
    print("| flight | position RMSE m | against fault-free | NEES (3) |\n|---|---|---|---|")
    print(f"| fault-free, fused | {best:.2f} | 1.00 | {nees(states, found):.2f} |")
    print(
        f"| fault-free, the detector's filter | {rmse(errors(decisions(clean), truths)):.2f} | | |"
    )
    faulty = detected(tlog_samples(folder / "sent.tlog"))
    for name, config in SETTINGS.items():
        states = fused(faulty, config)
        found = errors(states, truths)
        value = rmse(found)
        print(f"| faults, {name} | {value:.2f} | {value / best:.2f} | {nees(states, found):.1f} |")
    print(f"| faults, the detector's filter | {rmse(errors(decisions(faulty), truths)):.2f} | | |")


def gps_us(day: str, clock: str) -> int:
    """Microseconds since the start of GPS time, of a date and time in it."""
    stamp = datetime.strptime(f"{day} {clock}", "%Y/%m/%d %H:%M:%S.%f")
    since = stamp.replace(tzinfo=UTC) - GPS_EPOCH
    return round(since.total_seconds() * 1e6)


def positions(text: str, geoid_m: float) -> Truths:
    """RTKLIB's position file: latitude and longitude in rad, ellipsoidal height, by time."""
    found = {}
    for line in text.splitlines():
        if line and not line.startswith("%"):
            day, clock, lat, lon, height = line.split()[:5]
            found[gps_us(day, clock)] = (
                math.radians(float(lat)),
                math.radians(float(lon)),
                float(height) - geoid_m,
            )
    return found


def nearest(truths: Truths, stamps: Iterable[int]) -> Truths:
    """The reference at the nearest of its times, within 20 ms (a walk of 3 cm)."""
    known = np.array(sorted(truths))
    found = {}
    for t_us in stamps:
        best = int(known[np.argmin(np.abs(known - t_us))])
        if abs(best - t_us) <= 20_000:
            found[t_us] = truths[best]
    return found


def walk(folder: Path) -> None:
    """The table of the walk with a receiver and an IMU in hand."""
    observations, navigation = folder / "walk_ex.obs", folder / "walk_ex.nav"
    truths = positions((folder / "gnss_1730_sf.pos").read_text(), WALK_GEOID_M)
    command = ["rnx2rtkp", "-p", "0", "-m", "10", "-sys", "G,E", "-t", observations, navigation]
    single = positions(
        subprocess.run(command, check=True, capture_output=True, text=True).stdout, 0.0
    )
    near = nearest(truths, single)
    found = {
        t_us: ned_axes(*near[t_us][:2])
        @ (np.asarray(ecef_from_geodetic(*at)) - np.asarray(ecef_from_geodetic(*near[t_us])))
        for t_us, at in single.items()
        if t_us in near
    }
    print("| walk | position RMSE m | about its mean m | NEES (3) |\n|---|---|---|---|")
    print(f"| RTKLIB, single point | {rmse(found):.2f} | {spread(found):.2f} | |")
    samples = read_rinex_samples(observations, navigation, folder / "imu_1730_sf.csv")
    epochs = [s for s in samples if isinstance(s, Epoch)]
    truths = nearest(truths, [s.t_us for s in epochs])
    start_us = epochs[0].t_us
    rows = detected(samples)
    wrong = common(epochs)
    for title, these in (
        ("clean", rows),
        (
            f"{STEP_M:.0f} m on {wrong} for {STEP_FOR_S:.0f} s",
            detected(stepped(samples, wrong, start_us)),
        ),
    ):
        value = errors(decisions(these), truths)
        print(f"| {title}: the detector's filter | {rmse(value):.2f} | {spread(value):.2f} | |")
        for name, config in list(SETTINGS.items())[: 1 if title == "clean" else None]:
            states = fused(these, config)
            value = errors(states, truths)
            print(
                f"| {title}: {name} | {rmse(value):.2f} | {spread(value):.2f} "
                f"| {nees(states, value):.1f} |"
            )


def common(epochs: list[Epoch]) -> str:
    """The GPS satellite with the best signal over all epochs."""
    sums: dict[str, float] = {}
    for epoch in epochs:
        for name, cn0 in zip(epoch.satellites, epoch.cn0_dbhz, strict=True):
            if name[0] == "G" and np.isfinite(cn0):
                sums[name] = sums.get(name, 0.0) + float(cn0)
    return max(sums, key=lambda name: sums[name])


def stepped(samples: list[Sample], name: str, start_us: int) -> list[Sample]:
    """The samples with one satellite's pseudorange wrong for a while."""
    first = start_us + round(STEP_FROM_S * 1e6)
    last = first + round(STEP_FOR_S * 1e6)
    return [
        replace(
            s,
            pseudorange_m=s.pseudorange_m + STEP_M * np.array([n == name for n in s.satellites]),
        )
        if isinstance(s, Epoch) and first <= s.t_us < last
        else s
        for s in samples
    ]


def timing(folder: Path, satellites: int = 10) -> None:
    """Milliseconds of processor time per GNSS epoch with all samples since the last one.

    Of a recorded flight with fewer satellites.
    """
    samples: list[Sample] = []
    recorded = tlog_samples(folder / "received.tlog")
    until_us = recorded[0].t_us + TIMED_S * 1_000_000
    for sample in recorded:
        if sample.t_us > until_us:
            break
        if isinstance(sample, Epoch):
            keep = slice(0, satellites)
            sample = replace(
                sample,
                satellites=sample.satellites[keep],
                pseudorange_m=sample.pseudorange_m[keep],
                doppler_mps=sample.doppler_mps[keep],
                cn0_dbhz=sample.cn0_dbhz[keep],
            )
        samples.append(sample)
    rows = detected(samples)
    fusion = Fusion()
    state = fusion.new_state()
    spent: list[float] = []
    since = 0.0
    for sample, results, core in rows:
        before = time.process_time()
        said, state = fusion.step(sample, results, core, state)
        since += time.process_time() - before
        if said:
            spent.append(since)
            since = 0.0
    rest = np.array(spent[len(spent) // 4 :]) * 1e3
    rate = sum(isinstance(s, ImuSample) for s, _, _ in rows) / max(len(spent), 1)
    print(
        f"{satellites} satellites, {rate:.0f} IMU samples per epoch, 5 s lag: median "
        f"{np.median(rest):.2f} ms, 95 % {np.percentile(rest, 95):.2f} ms per GNSS epoch "
        f"({platform.processor() or platform.machine()}, Python {platform.python_version()})"
    )


if __name__ == "__main__":
    {"flight": flight, "walk": walk, "time": timing}[sys.argv[1]](Path(sys.argv[2]))
