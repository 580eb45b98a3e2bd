"""The section of benchmarks/fdi.py on a walk with a real IMU, its faults put in by the proxy."""

from collections import Counter
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from analysis.detection import Detector, DetectorConfig
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.decoder import Decoder
from analysis.samples.sample import EphemerisSample, Epoch, ImuSample, Sample
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser

FROM_S, UNTIL_S = 55.0, 70.0
GEOID_M = 21.387  # the reference's heights are above it
GPS_DAY_ZERO = datetime(1980, 1, 6)
FAULTS = {
    "none": "",
    "gyro + 0.3 rad/s": "{fault: bias, target: HIL_SENSOR.xgyro, value: 0.3, WHEN}",
    "gyro + 0.1 rad/s": "{fault: bias, target: HIL_SENSOR.xgyro, value: 0.1, WHEN}",
    "gyro frozen": "{fault: freeze, target: HIL_SENSOR.zgyro, WHEN}",
    "accelerometer + 3 m/s^2": "{fault: bias, target: HIL_SENSOR.yacc, value: 3, WHEN}",
    "accelerometer + 1 m/s^2": "{fault: bias, target: HIL_SENSOR.yacc, value: 1, WHEN}",
    "accelerometer x 1.3": "{fault: scale, target: HIL_SENSOR.zacc, value: 1.3, WHEN}",
    "dropout": "{fault: drop, target: HIL_SENSOR, WHEN}",
}


def through_proxy(samples: list[Sample], fault: str) -> list[Sample]:
    """The samples, their IMU sent as HIL_SENSOR through the proxy with one fault."""
    text = fault.replace("WHEN", f"at_s: {FROM_S}, for_s: {UNTIL_S - FROM_S}")
    engine = Engine(parse_schedule(f"faults: [{text}]"))
    core = Core((LinkRole("sim", "to-vehicle"), LinkRole("out", "from-vehicle")), engine)
    decoder, out = Decoder(), []
    first = next(s.t_us for s in samples if isinstance(s, ImuSample))
    for s in samples:
        if not isinstance(s, ImuSample):
            out.append(s)
            continue
        values = dict(zip(("xgyro", "ygyro", "zgyro"), s.gyro_b_rps.tolist(), strict=True))
        values |= dict(zip(("xacc", "yacc", "zacc"), s.accel_b_mps2.tolist(), strict=True))
        stamp = {"time_usec": s.t_us - first, "fields_updated": 0x3F}
        data = build_frame(message_layout("HIL_SENSOR"), values | stamp, component=51)
        for send in core.received(0, data, s.t_us):
            for frame in Parser().push(send.data, datagram=True):
                if isinstance(frame, Frame):
                    found = decoder.decode([frame]).samples()
                    out += [replace(sample, t_us=sample.t_us + first) for sample in found]
    return out


def reference(path: Path) -> dict[int, np.ndarray]:
    """ECEF positions of the RTK solution by quarter of a second of GPS time."""
    found = {}
    for line in path.read_text().splitlines():
        if not line.startswith("%"):
            day, clock, lat, lon, height = line.split()[:5]
            at = datetime.strptime(f"{day} {clock}", "%Y/%m/%d %H:%M:%S.%f") - GPS_DAY_ZERO
            place = np.radians(float(lat)), np.radians(float(lon)), float(height) - GEOID_M
            found[round(at.total_seconds() * 4)] = np.asarray(ecef_from_geodetic(*place))
    return found


def range_errors(
    samples: list[Sample], where: dict[int, np.ndarray]
) -> dict[str, dict[int, float]]:
    """Each satellite's range error in sigmas against the reference, less its median of the walk
    (the reference's own datum) and each epoch's median (the clock)."""
    detector = Detector()
    state = detector.new_state()
    errors: dict[str, dict[int, float]] = {}
    for s in samples:
        if isinstance(s, EphemerisSample):
            state = detector.step(s, state)[1]
        if not isinstance(s, Epoch) or round(s.t_us * 4e-6) not in where:
            continue
        observed = observe_epoch(s, select_ephemerides(s, state.core.broadcast.ephemerides))
        if observed is None:
            continue
        x = np.zeros(21)
        x[0:3], x[6] = where[round(s.t_us * 4e-6)], 1.0
        seen = predict_innovations(
            observed, x, detector.config.sigma, state.core.broadcast.ionosphere
        )
        for system in "GE":
            own = np.array([name[0] == system for name in observed.satellites])
            high = own & (seen.elevation_rad > np.radians(20.0))
            clock = np.median(seen.range_m[high]) if high.any() else np.nan
            for i in np.flatnonzero(own):
                off = (seen.range_m[i] - clock) / np.sqrt(seen.variance[i])
                errors.setdefault(observed.satellites[i], {})[s.t_us] = float(off)
    for row in errors.values():
        middle = float(np.median(list(row.values())))
        for t_us in row:
            row[t_us] -= middle
    return errors


def walk(data: Path) -> None:
    """Real IMU and GNSS, walking; IMU faults added."""
    folder = data / "gnss_imu_walk"
    samples = read_rinex_samples(
        folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    )
    first = next(s.t_us for s in samples if isinstance(s, ImuSample))
    where = reference(folder / "gnss_1730_sf.pos")
    errors = range_errors(samples, where)
    print("\n## Walk, real IMU, nothing injected: every alarm\n")
    print(
        "| at, s | satellite | its range error by RTK in the 5 s around, sigmas: least, largest |"
    )
    print("|---|---|---|")
    usual = decisions(samples)
    out: set[str] = set()
    for d in usual:
        for name in sorted(set(d.excluded) - out):
            near = [e for t, e in errors[name].items() if abs(t - d.t_us) <= 5_000_000]
            print(f"| {(d.t_us - first) * 1e-6:.1f} | {name} | {min(near):.1f}, {max(near):.1f} |")
        out = set(d.excluded)
    spread = spread_m(usual, where)
    print(f"\nHorizontal error less its mean (the reference's datum): {spread:.2f} m RMS.")
    systems(samples, where)
    print(
        f"\n## Walk: faults of the IMU put in by the proxy from {FROM_S:.0f} s to {UNTIL_S:.0f} s\n"
    )
    print("| fault | first verdict in the fault | after, s | satellites excluded, not so without |")
    print("|---|---|---|---|")
    for name, fault in FAULTS.items():
        row(name, decisions(through_proxy(samples, fault)), usual, first)


def spread_m(found: list[Decision], where: dict[int, np.ndarray]) -> float:
    """Horizontal error less its mean, RMS."""
    off = np.array([d.position_ecef_m - where[k] for d in found if (k := key(d)) in where])
    level = (off @ ned_axes(np.radians(40.0967), np.radians(-105.1472)).T)[:, :2]
    return float(np.hypot(*level.std(axis=0)))


def systems(samples: list[Sample], where: dict[int, np.ndarray]) -> None:
    """What each system is worth."""
    print("\n## Walk by systems, nothing injected\n")
    print("| systems | satellites | parity chi-square per dof | alarms | horizontal error, m RMS |")
    print("|---|---|---|---|---|")
    for names in ("GE", "GC", "GEC"):
        found = decisions(samples, DetectorConfig(systems=names))
        tested = [d for d in found if d.parity_dof]
        ratio = sum(d.parity_statistic for d in tested) / sum(d.parity_dof for d in tested)
        print(
            f"| {names} | {np.mean([len(d.satellites) for d in found]):.1f} | {ratio:.2f}"
            f" | {sum(d.alarm for d in found)} | {spread_m(found, where):.2f} |"
        )


def decisions(samples: list[Sample], config: DetectorConfig | None = None) -> list[Decision]:
    """The decisions of the detector, with its defaults if nothing else is said."""
    detector = Detector(config or DetectorConfig())
    state, found = detector.new_state(), []
    for s in samples:
        results, state = detector.step(s, state)
        found += [r for r in results if isinstance(r, Decision)]
    return found


def key(decision: Decision) -> int:
    """The quarter of a second of a decision."""
    return round(decision.t_us * 4e-6)


def row(name: str, found: list[Decision], usual: list[Decision], first: int) -> None:
    """One fault's line."""
    during = [d for d in found if FROM_S <= (d.t_us - first) * 1e-6 < UNTIL_S]
    alarm = next((d for d in during if d.alarm), None)
    clean = Counter(s for d in usual for s in d.excluded)
    isolated = {s for d in during for s in d.excluded} - clean.keys()
    said = f"{alarm.hypothesis} | {(alarm.t_us - first) * 1e-6 - FROM_S:.1f}" if alarm else "- | -"
    print(f"| {name} | {said} | {', '.join(sorted(isolated)) or '-'} |")
