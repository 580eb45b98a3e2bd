"""Sections of benchmarks/fdi.py on a real static recording."""

import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch, Sample
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

STATIC_TRUTH_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])


def horizontal_m(position: tuple[float, float, float]) -> float:
    """Distance from the static antenna in the horizontal."""
    lat, lon, _ = geodetic_position(STATIC_TRUTH_M)
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


def whole(data: Path) -> None:
    """How often the whole detector cries wolf: real geometry, noise as its own model has it.

    Position and clock walk at random as the process noise says; every test is on.
    """
    folder = data / "gnss_static"
    samples = read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    print("\n## All alarms of the whole detector, no IMU, noise of its own model\n")
    print("| main test | tests with memory | epochs | sum of both x epochs | alarms |")
    print("|---|---|---|---|---|")
    for p in (1e-3, 1e-4):
        config = DetectorConfig(p_false_alarm=p, p_slow=p)
        epochs = alarms = 0
        for seed in range(8):
            drawn = with_noise(samples, config, np.random.default_rng(seed))
            found = [r for r in run_detector(Detector(config), drawn) if isinstance(r, Decision)]
            epochs += len(found)
            alarms += sum(d.alarm for d in found)
        print(f"| {p:g} | {p:g} | {epochs} | {2 * p * epochs:.1f} | {alarms} |")


def with_noise(
    samples: list[Sample], config: DetectorConfig, rng: np.random.Generator
) -> list[Sample]:
    """The recording with ranges as the detector's own model draws them."""
    detector = Detector(config)
    state, x, out, last_us = detector.new_state(), np.zeros(21), [], 0
    x[0:3], x[6] = STATIC_TRUTH_M, 1.0
    noise = config.noise
    for s in samples:
        if not isinstance(s, Epoch):
            state = detector.step(s, state)[1]
            out.append(s)
            continue
        dt = (s.t_us - last_us) * 1e-6 if last_us else 0.0
        last_us = s.t_us
        pushed = noise.motion_mps2 * np.sqrt(dt) * rng.standard_normal(3)
        x[0:3] += dt * (x[3:6] + 0.5 * pushed)
        x[0:3] += noise.motion_mps2 * np.sqrt(dt**3 / 12.0) * rng.standard_normal(3)
        x[3:6] += pushed
        x[16] += dt * x[17] + noise.clock_m * np.sqrt(dt) * rng.standard_normal()
        x[17] += noise.drift_mps * np.sqrt(dt) * rng.standard_normal()
        chosen = select_ephemerides(s, state.core.broadcast.ephemerides)
        observed = observe_epoch(s, chosen)
        if observed is None:
            continue
        seen = predict_innovations(observed, x, config.sigma, state.core.broadcast.ionosphere)
        drawn = np.sqrt(seen.variance) * rng.standard_normal(len(seen.range_m))
        out.append(
            Epoch(
                s.t_us,
                s.week,
                s.tow_s,
                observed.satellites,
                observed.measurements.pseudorange_m - seen.range_m + drawn,
                np.full(len(drawn), np.nan),
                observed.measurements.cn0_dbhz,
            )
        )
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
        clean = [r for r in run_detector(Detector(), samples) if isinstance(r, Decision)]
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
    return sample.select([i for i, name in enumerate(sample.satellites) if name[0] in systems])


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
            r
            for r in run_detector(Detector(), changed)
            if isinstance(r, Decision) and r.t_us >= from_us
        ]
        first_right += window[0].excluded == bad
        found = next((d for d in window if bad[0] in d.excluded), None)
        if isinstance(size, tuple) and found is not None:
            sizes.append(size[1] * (found.t_us - from_us) * 1e-6)
        right += sum(d.excluded == bad for d in window)
        total += len(window)
        usual = [
            r
            for r in run_detector(Detector(), part)
            if isinstance(r, Decision) and r.t_us >= from_us
        ]
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
