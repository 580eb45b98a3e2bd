"""What the detector is worth: the tables of docs/fdi.md, measured.

    python benchmarks/fdi.py [SECTION ...] [--data DIR]

Sections: alarms power isolation ramps static walk speed (default: all). The Monte Carlo sections
draw innovations with their exact covariance and put them to the same bank, thresholds and windows
that the live path uses. `static` and `walk` need the folder of real logs and, for the peer,
RTKLIB's rnx2rtkp.
"""

import argparse
import os
import shutil
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import binom

from analysis.epochs import read_rinex_samples
from analysis.fdi import Detector, DetectorConfig
from analysis.fdi.bank import normalised, projected_weights
from analysis.fdi.detector import run
from analysis.fdi.inertial import propagate_inertial
from analysis.fdi.memory import STRIDE_S, WINDOWS, ramp_statistics, respond
from analysis.fdi.slow import EPISODES, YOUNGEST_S
from analysis.fdi.thresholds import chi_square, two_sided
from analysis.fdi.verdict import judge
from analysis.gnss import geodetic, ned_axes
from analysis.results import Decision
from analysis.samples import Epoch, ImuSample, Sample

STATIC_TRUTH_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])
RNG = np.random.default_rng(20260101)


def geometry(count: int) -> np.ndarray:
    """Random open sky above 10 degrees with PDOP below 4: minus unit vectors and the clock."""
    while True:
        azimuth = RNG.uniform(0.0, 2.0 * np.pi, count)
        sine = RNG.uniform(np.sin(np.radians(10.0)), 1.0, count)
        cosine = np.sqrt(1.0 - sine**2)
        design = np.column_stack(
            [-cosine * np.sin(azimuth), -cosine * np.cos(azimuth), -sine, np.ones(count)]
        )
        if np.trace(np.linalg.inv(design.T @ design)[:3, :3]) < 16.0:
            return design


def covariance(design: np.ndarray) -> np.ndarray:
    """Innovations with position and clock predicted to one sigma of a pseudorange."""
    return design @ design.T + np.eye(len(design))


def statistics(design: np.ndarray, draws: int, bias: float) -> tuple[np.ndarray, ...]:
    """Statistics of `draws` epochs with `bias` on a random satellite: innovation test, snapshot
    test, largest normalised innovation."""
    count = len(design)
    s = covariance(design)
    m = np.linalg.inv(s)
    v = RNG.standard_normal((draws, count)) @ np.linalg.cholesky(s).T
    v[np.arange(draws), RNG.integers(count, size=draws)] += bias
    projected = projected_weights(design, np.ones(count))
    single = np.array([normalised(m, m @ row) for row in v[:50]])
    return (
        np.einsum("ni,ij,nj->n", v, m, v),
        np.einsum("ni,ij,nj->n", v, projected, v),
        np.abs(single).max(axis=1),
    )


def alarms() -> None:
    """Rate over clean epochs."""
    print("\n## False alarms over clean epochs (innovation test; snapshot test)\n")
    print("| satellites | epochs | configured | 99 % interval | innovation | snapshot |")
    print("|---|---|---|---|---|---|")
    for count in (7, 10, 12):
        sets = [statistics(geometry(count), 1000, 0.0) for _ in range(1000)]
        total = 1000 * len(sets)
        for p in (1e-3, 1e-4):
            low, high = binom.interval(0.99, total, p)
            full = sum(int((q > chi_square(count, p)).sum()) for q, _, _ in sets)
            snap = sum(int((q > chi_square(count - 4, p)).sum()) for _, q, _ in sets)
            print(f"| {count} | {total} | {p:g} | {low:.0f} to {high:.0f} | {full} | {snap} |")


def power() -> None:
    """Share of epochs found, one faulty satellite."""
    best = {
        (7, 1e-3): (".34/.45", ".53/.73", ".78/.98", ".88/1.0", ".96/1"),
        (8, 1e-4): (".20/.24", ".41/.53", ".77/.94", ".90/1.0", ".97/1"),
        (10, 1e-4): (".22/.23", ".46/.52", ".85/.94", ".96/1.0", "1/1"),
        (12, 1e-4): (".22/.22", ".47/.50", ".89/.94", ".98/1", "1/1"),
    }
    print("\n## Detection power: snapshot / innovation / per-satellite test, (best possible)\n")
    print("| m, Pfa | b = 5 | 6 | 8 | 10 | 15 |\n|---|---|---|---|---|---|")
    for (count, p), row in best.items():
        cells = []
        for bias, known in zip((5.0, 6.0, 8.0, 10.0, 15.0), row, strict=True):
            sets = [statistics(geometry(count), 100, bias) for _ in range(1500)]
            full = np.mean(np.concatenate([q for q, _, _ in sets]) > chi_square(count, p))
            snap = np.mean(np.concatenate([q for _, q, _ in sets]) > chi_square(count - 4, p))
            each = np.mean(np.concatenate([z for _, _, z in sets]) > two_sided(p / count))
            cells.append(f"{snap:.2f}/{full:.2f}/{each:.2f} ({known})")
        print(f"| {count}, {p:g} | " + " | ".join(cells) + " |")


def verdicts(kind: str, bias: float, trials: int, rule: str, largest: int) -> Counter[str]:
    """Verdicts over trials, m = 10, Pfa 1e-4."""
    counts: Counter[str] = Counter()
    for _ in range(trials):
        design = geometry(10)
        s = covariance(design)
        v = np.linalg.cholesky(s) @ RNG.standard_normal(10)
        bad: tuple[int, ...] = ()
        if kind == "IMU":
            turn = RNG.standard_normal(3)
            v += design[:, :3] @ (bias * turn / np.linalg.norm(turn))
        else:
            bad = tuple(sorted(int(i) for i in RNG.choice(10, int(kind), replace=False)))
            v[list(bad)] += bias * RNG.choice([-1.0, 1.0], len(bad))
        m = np.linalg.inv(s)
        name = "none"
        if v @ m @ v > chi_square(10, 1e-4):
            found = judge(m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, largest, rule)
            name = found.hypothesis
            if name == "satellites":
                name = "right satellites" if found.subset == bad else "wrong satellites"
        counts[name] += 1
    return counts


def isolation() -> None:
    """Who is blamed."""
    trials = 2000
    print(f"\n## Verdicts, m = 10, Pfa 1e-4, {trials} trials each, shares in %\n")
    print("| truth | rule D, at most 3 left out | rule D, at most 2 | the plain rule (2) |")
    print("|---|---|---|---|")
    cases = [("1", 10.0), ("2", 10.0), ("3", 10.0), ("5", 10.0), ("IMU", 8.0), ("IMU", 12.0)]
    for kind, bias in cases:
        cells = []
        for rule, largest in (("explicit", 3), ("explicit", 2), ("plain", 2)):
            counts = verdicts(kind, bias, trials, rule, largest)
            cells.append(
                ", ".join(f"{name} {100 * n / trials:.1f}" for name, n in counts.most_common())
            )
        what = "IMU position error" if kind == "IMU" else f"{kind} satellites"
        print(f"| {what}, {bias:.0f} sigma | " + " | ".join(cells) + " |")


def ramp_run(slope: float, onset: int, epochs: int, threshold: float) -> tuple[int, list[int]]:
    """A filter of position and clock with a ramp on satellite 0, epochs of 0.2 s.

    The first alarm after `onset` (-1: none) and those before; windows start anew after an alarm.
    """
    count, dt = 10, 0.2
    h = geometry(count)
    p = np.eye(4)
    m = np.linalg.inv(covariance(h))
    gain = p @ h.T @ m
    kick = np.linalg.cholesky(gain @ h @ p + 1e-12 * np.eye(4))
    phi, slots, zero = np.eye(4), np.arange(count), np.zeros(count)
    each = 2 * count + 3
    d, sums = np.zeros((4, WINDOWS * each)), np.zeros((WINDOWS, 5 * count + 12))
    starts, error, false = np.zeros(WINDOWS), np.zeros(4), []
    noise, drift = RNG.standard_normal((epochs, count)), RNG.standard_normal((epochs, 4))
    for k in range(epochs):
        t = k * dt
        v = h @ error + noise[k]
        v[0] += slope * max(t - onset * dt, 0.0)
        if t - starts.max() >= STRIDE_S:
            w = int(starts.argmin())
            starts[w], d[:, w * each : (w + 1) * each], sums[w] = t, 0.0, 0.0
        d, sums = respond(d, sums, t - starts, phi, gain, m, h, v, slots, dt)
        old = t - starts >= YOUNGEST_S
        if (ramp_statistics(sums, zero, 0.0)[old] > threshold).any():
            if k >= onset:
                return k - onset, false
            false.append(k)
            d[:], sums[:], starts[:] = 0.0, 0.0, t + dt
        error = error - gain @ v + kick @ drift[k]
    return -1, false


def ramps() -> None:
    """Delays of the tests with memory."""
    threshold = chi_square(1, 1e-4 / (EPISODES * 10))
    false = epochs = 0
    for _ in range(40):
        false += len(ramp_run(0.0, 10**9, 5000, threshold)[1])
        epochs += 5000
    print("\n## Ramps, m = 10, 5 Hz, windows with memory, configured 1 false alarm in 1e4 epochs\n")
    print(f"False alarms: {false} in {epochs} clean epochs ({false / epochs:.1e} an epoch).\n")
    print("| ramp, sigma/s | CUSUM's mean delay in the facts, s | measured, s |\n|---|---|---|")
    for slope, known in ((0.1, 11.0), (0.5, 4.6), (1.0, 3.2)):
        delays = []
        while len(delays) < 300:
            onset = 100 + int(RNG.integers(25))  # any place between two windows' starts
            delay, _ = ramp_run(slope, onset, onset + 300, threshold)
            if delay >= 0:
                delays.append(delay * 0.2)
        error = np.std(delays) / np.sqrt(len(delays))
        print(f"| {slope} | {known} | {np.mean(delays):.2f} +- {error:.2f} |")


def horizontal_m(position: tuple[float, float, float]) -> float:
    """Distance from the static antenna in the horizontal."""
    lat, lon, _ = geodetic(STATIC_TRUTH_M)
    off = ned_axes(lat, lon) @ (np.array(position) - STATIC_TRUTH_M)
    return float(np.hypot(off[0], off[1]))


def faulted(samples: list[Sample], faults: dict[str, object], from_us: int, until_us: int):
    """The samples with metres added to satellites' ranges: numbers, or slopes as ("ramp", m/s)."""
    out = []
    for sample in samples:
        if isinstance(sample, Epoch) and from_us <= sample.t_us < until_us:
            ranges = sample.pseudorange_m.copy()
            for name, fault in faults.items():
                if name in sample.satellites:
                    size = fault
                    if isinstance(fault, tuple):
                        size = fault[1] * (sample.t_us - from_us) * 1e-6
                    ranges[sample.satellites.index(name)] += size
            sample = replace(sample, pseudorange_m=ranges)
        out.append(sample)
    return out


def rtklib(text: list[str], navigation: Path, systems: str) -> dict[int, tuple[float, ...]]:
    """Positions of rnx2rtkp's single-point solution with RAIM FDE by second of the hour."""
    with tempfile.TemporaryDirectory() as folder:
        observations, options = Path(folder, "a.21O"), Path(folder, "a.conf")
        observations.write_text("".join(text))
        options.write_text(
            "pos1-posmode=single\npos1-elmask=10\npos1-ionoopt=brdc\npos1-tropopt=saas\n"
            f"pos1-navsys={systems}\npos1-posopt5=on\nout-solformat=xyz\nout-timeform=tow\n"
        )
        done = subprocess.run(
            ["rnx2rtkp", "-k", options, observations, navigation],
            capture_output=True,
            text=True,
            check=True,
        )
    found = {}
    for line in done.stdout.splitlines():
        if not line.startswith("%"):
            parts = line.split()
            found[round(float(parts[1]))] = tuple(float(x) for x in parts[2:5])
    return found


def patched_text(lines: list[str], faults: dict[str, object], first: int, last: int) -> list[str]:
    """The observation file with the same faults in epochs `first` to `last` (L1 code only)."""
    out, epoch = [], -1
    for line in lines:
        if line.startswith(">"):
            epoch += 1
        elif first <= epoch < last and line[:3] in faults:
            fault = faults[line[:3]]
            size = fault[1] * (epoch - first) if isinstance(fault, tuple) else fault
            line = line[:3] + f"{float(line[3:17]) + size:14.3f}" + line[17:]
        out.append(line)
    return out


def static(data: Path) -> None:
    """Faults injected into a real static recording."""
    folder = data / "gnss_static"
    files = folder / "SEPT078M.21O", folder / "SEPT078M.21P"
    lines = files[0].read_text().splitlines(keepends=True)
    every = read_rinex_samples(*files)
    peer = shutil.which("rnx2rtkp") is not None
    for label, systems, mask in (("GPS", "G", 1), ("GPS + Galileo", "GE", 9)):
        samples = [only(s, systems) for s in every]
        clean = [r for r in run(Detector(), samples) if isinstance(r, Decision)]
        wrong = sum(bool(d.excluded) for d in clean)
        rms = np.sqrt(np.mean([horizontal_m(d.position_ecef_m) ** 2 for d in clean[60:]]))
        ratio = np.mean([d.statistic / d.dof for d in clean])
        print(f"\n## Static antenna, real data, {label}: 20 trials each, faults of 60 s\n")
        print(
            f"Clean: {len(clean)} epochs, {sum(d.alarm for d in clean)} alarms, {wrong} epochs with"
            f" an exclusion, chi-square per degree of freedom {ratio:.2f}, horizontal"
            f" RMS {rms:.2f} m.\n"
        )
        print(
            "| fault | isolated at the first epoch | mean size when found | epochs right"
            " | horizontal error / clean | RTKLIB RAIM FDE: epochs right |"
        )
        print("|---|---|---|---|---|---|")
        base = rtklib(lines, files[1], str(mask)) if peer else {}
        cases: list[tuple[str, object, int]] = [
            ("50 m step", 50.0, 1),
            ("20 m step", 20.0, 1),
            ("0.5 m/s ramp", ("ramp", 0.5), 1),
            ("50 m on two", 50.0, 2),
        ]
        for name, size, number in cases:
            static_case(name, size, number, samples, clean, lines, files[1], base, mask)


def only(sample: Sample, systems: str) -> Sample:
    """An epoch with the satellites of some systems."""
    if not isinstance(sample, Epoch):
        return sample
    keep = [i for i, name in enumerate(sample.satellites) if name[0] in systems]
    return replace(
        sample,
        satellites=tuple(sample.satellites[i] for i in keep),
        pseudorange_m=sample.pseudorange_m[keep],
        doppler_mps=sample.doppler_mps[keep],
        cn0_dbhz=sample.cn0_dbhz[keep],
    )


def static_case(name, size, number, samples, clean, lines, navigation, base, mask) -> None:
    """One row: the same trials for the detector and RTKLIB."""
    rng = np.random.default_rng(7)
    epochs = [s for s in samples if isinstance(s, Epoch)]
    rest = [s for s in samples if not isinstance(s, Epoch)]
    first_right, sizes, right, total, ratios, peer_right = 0, [], 0, 0, [], 0
    for _ in range(20):
        start = int(rng.integers(60, len(epochs) - 70))
        used = clean[start].satellites
        bad = tuple(sorted(str(x) for x in rng.choice(used, number, replace=False)))
        faults = dict.fromkeys(bad, size)
        part = [*rest, *epochs[start - 60 : start + 60]]
        from_us = epochs[start].t_us
        changed = faulted(part, faults, from_us, from_us + 60_000_000)
        window = [
            r for r in run(Detector(), changed) if isinstance(r, Decision) and r.t_us >= from_us
        ]
        first_right += window[0].excluded == bad
        found = next((d for d in window if bad[0] in d.excluded), None)
        if isinstance(size, tuple) and found is not None:
            sizes.append(size[1] * (found.t_us - from_us) * 1e-6)
        right += sum(d.excluded == bad for d in window)
        total += len(window)
        usual = [r for r in run(Detector(), part) if isinstance(r, Decision) and r.t_us >= from_us]
        ratios.append(
            np.sqrt(np.mean([horizontal_m(d.position_ecef_m) ** 2 for d in window]))
            / np.sqrt(np.mean([horizontal_m(d.position_ecef_m) ** 2 for d in usual]))
        )
        if base:
            text = patched_text(lines, faults, start, start + 60)
            solved = rtklib(text, navigation, str(mask))
            for epoch in epochs[start : start + 60]:
                at = round(epoch.tow_s)
                if at in solved and at in base:
                    off = horizontal_m(solved[at]) - horizontal_m(base[at])
                    peer_right += abs(off) < 1.0
    grown = f"{np.mean(sizes):.1f} m, largest {np.max(sizes):.1f} m" if sizes else "-"
    other = f"{100 * peer_right / total:.0f} %" if base else "not installed"
    print(
        f"| {name} | {5 * first_right} % | {grown} | {100 * right / total:.0f} %"
        f" | mean {np.mean(ratios):.2f}, largest {np.max(ratios):.2f} | {other} |"
    )


def walk(data: Path) -> None:
    """Real IMU and GNSS, walking; IMU faults added."""
    folder = data / "gnss_imu_walk"
    samples = read_rinex_samples(
        folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    )
    first = next(s.t_us for s in samples if isinstance(s, ImuSample))

    def with_imu(gyro: float, accel: float, drop: bool) -> list[Sample]:
        out = []
        for s in samples:
            if isinstance(s, ImuSample) and 70e6 <= s.t_us - first < 85e6:
                if drop:
                    continue
                s = replace(
                    s,
                    gyro_b_rps=s.gyro_b_rps + np.array([gyro, 0.0, 0.0]),
                    accel_b_mps2=s.accel_b_mps2 + np.array([0.0, accel, 0.0]),
                )
            out.append(s)
        return out

    print("\n## Walk, real IMU: faults of the IMU from 70 s to 85 s\n")
    print(
        "| fault | alarms before | first verdict in the fault | after, s"
        " | satellites excluded in the fault that are not on clean data |\n|---|---|---|---|---|"
    )
    usual: set[str] = set()
    cases = [
        ("none", 0.0, 0.0, False),
        ("gyro + 0.3 rad/s", 0.3, 0.0, False),
        ("gyro + 0.1 rad/s", 0.1, 0.0, False),
        ("accelerometer + 3 m/s^2", 0.0, 3.0, False),
        ("dropout", 0.0, 0.0, True),
    ]
    for name, gyro, accel, drop in cases:
        found = [r for r in run(Detector(), with_imu(gyro, accel, drop)) if isinstance(r, Decision)]
        before = Counter(d.hypothesis for d in found if d.alarm and d.t_us - first < 70e6)
        during = [d for d in found if 70e6 <= d.t_us - first < 85e6]
        blamed = {s for d in during for s in d.excluded}
        if name == "none":
            usual = blamed
        alarm = next((d for d in during if d.alarm), None)
        text = f"{alarm.hypothesis} | {(alarm.t_us - first) * 1e-6 - 70:.1f}" if alarm else "- | -"
        print(f"| {name} | {dict(before)} | {text} | {sorted(blamed - usual)} |")


def speed(data: Path) -> None:
    """Time per IMU step and per epoch, and end to end."""
    folder = data / "gnss_imu_walk"
    files = folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    run(Detector(), read_rinex_samples(*files)[:6000])  # compile
    began = time.process_time()
    samples = read_rinex_samples(*files)
    read_s = time.process_time() - began
    began = time.process_time()
    run(Detector(), samples)
    whole_s = time.process_time() - began
    imu = [s for s in samples if isinstance(s, ImuSample)]
    x, p = np.zeros(19), np.eye(18)
    x[:3], x[6] = STATIC_TRUTH_M, 1.0
    block = np.tile(np.r_[0.005, 0.1, 0.0, 0.0, 0.0, 0.0, -9.8], (2000, 1))
    noise = DetectorConfig().noise.densities()
    propagate_inertial(x, p, block, noise)
    began = time.process_time()
    propagate_inertial(x, p, block, noise)
    step_us = (time.process_time() - began) / len(block) * 1e6
    static_folder = data / "gnss_static"
    every = read_rinex_samples(static_folder / "SEPT078M.21O", static_folder / "SEPT078M.21P")
    twelve = [fewer(s) for s in every]
    run(Detector(), twelve[:300])
    began = time.process_time()
    count = sum(isinstance(r, Decision) for r in run(Detector(), twelve))
    epoch_us = (time.process_time() - began) / count * 1e6
    design = geometry(12)
    m = np.linalg.inv(covariance(design))
    v = np.full(12, 10.0) * RNG.choice([-1.0, 1.0], 12)
    judge(m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, 2)
    began = time.process_time()
    for _ in range(500):
        judge(m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, 2)
    bank_us = (time.process_time() - began) / 500 * 1e6
    a = np.eye(18) + 0.1
    began = time.process_time()
    for _ in range(2000):
        np.linalg.inv(a)
    unit_us = (time.process_time() - began) / 2000 * 1e6
    flight_s = (imu[-1].t_us - imu[0].t_us) * 1e-6
    print("\n## Speed, CPU time of one core\n\n| what | measured |\n|---|---|")
    print(f"| numpy.linalg.inv of 18 x 18 on this machine, for scale | {unit_us:.0f} us |")
    print(f"| one IMU step, state and covariance | {step_us:.1f} us |")
    print(f"| one epoch of 12 satellites, no IMU, all tests | {epoch_us:.0f} us |")
    print(
        f"| the bank, one and two left out, rivals and verdict, 12 satellites | {bank_us:.0f} us |"
    )
    print(
        f"| gnss_imu_walk, {flight_s:.0f} s of 152 Hz IMU and 4 Hz GNSS: reading | {read_s:.2f} s |"
    )
    print(f"| the same, detecting | {whole_s:.2f} s, {flight_s / whole_s:.0f} times real time |")


def fewer(sample: Sample) -> Sample:
    """An epoch with its first twelve GPS and Galileo satellites of those always there."""
    if not isinstance(sample, Epoch):
        return sample
    names = ["E03", "E08", "E13", "E15", "E21", "G01", "G03", "G04", "G06", "G09", "G17", "G19"]
    keep = [i for i, name in enumerate(sample.satellites) if name in names]
    return replace(
        sample,
        satellites=tuple(sample.satellites[i] for i in keep),
        pseudorange_m=sample.pseudorange_m[keep],
        doppler_mps=sample.doppler_mps[keep],
        cn0_dbhz=sample.cn0_dbhz[keep],
    )


def main() -> None:
    """Print the sections asked for."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__)
    sections = ("alarms", "power", "isolation", "ramps", "static", "walk", "speed")
    parser.add_argument("section", nargs="*", choices=[*sections, []], default=[])
    parser.add_argument("--data", type=Path, default=os.environ.get("MAVPROXY_FAULT_DATA", beside))
    args = parser.parse_args()
    for section in args.section or sections:
        if section in ("static", "walk", "speed"):
            {"static": static, "walk": walk, "speed": speed}[section](Path(args.data))
        else:
            {"alarms": alarms, "power": power, "isolation": isolation, "ramps": ramps}[section]()


if __name__ == "__main__":
    main()
