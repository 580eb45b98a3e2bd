"""Monte Carlo sections of benchmarks/fdi.py: innovations drawn with their exact covariance."""

from collections import Counter

import numpy as np
from scipy.stats import binom

from analysis.detection.filter.inertial import CLOCK, ERROR_SIZE
from analysis.detection.filter.information import normal_equations_over
from analysis.detection.isolation.hypotheses import select_hypothesis
from analysis.detection.isolation.ramp_windows import (
    STRIDE_S,
    WINDOW_COUNT,
    YOUNGEST_S,
    RampWindows,
    ramp_ratio,
    respond,
)
from analysis.detection.statistics.bank import projected_weights
from analysis.detection.statistics.chi_square import chi_square_threshold, two_sided_bound

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
    single = np.array([m @ row / np.sqrt(np.diag(m)) for row in v[:50]])
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
            full = sum(int((q > chi_square_threshold(count, p)).sum()) for q, _, _ in sets)
            snap = sum(int((q > chi_square_threshold(count - 4, p)).sum()) for _, q, _ in sets)
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
            full = np.mean(np.concatenate([q for q, _, _ in sets]) > chi_square_threshold(count, p))
            snap = np.mean(
                np.concatenate([q for _, q, _ in sets]) > chi_square_threshold(count - 4, p)
            )
            each = np.mean(np.concatenate([z for _, _, z in sets]) > two_sided_bound(p / count))
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
        if v @ m @ v > chi_square_threshold(10, 1e-4):
            found = select_hypothesis(
                m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, largest, rule
            )
            name = found.hypothesis
            if name == "satellites":
                name = "right satellites" if found.subset == bad else "wrong satellites"
        counts[name] += 1
    return counts


def isolation() -> None:
    """Which hypothesis is selected."""
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
    states, ones, after = np.array([0, 1, 2, CLOCK]), np.ones(count), np.zeros((ERROR_SIZE, 4))
    after[states] = p - gain @ h @ p
    zero, w = np.zeros((WINDOW_COUNT, count)), WINDOW_COUNT
    d, sums = np.zeros((ERROR_SIZE, w, count + 3)), np.zeros((5, w, count))
    c, j, none = np.zeros((w, 3)), np.zeros((w, 3, 3)), np.zeros(w, np.int64)
    windows = RampWindows(none, d, sums, c, j, zero[0], zero[0], zero, zero)
    starts, error, false = np.zeros(WINDOW_COUNT), np.zeros(4), []
    noise, drift = RNG.standard_normal((epochs, count)), RNG.standard_normal((epochs, 4))
    for k in range(epochs):
        t = k * dt
        v = h @ error + noise[k]
        v[0] += slope * max(t - onset * dt, 0.0)
        if t - starts.max() >= STRIDE_S:
            w = int(starts.argmin())
            starts[w], d[:, w], sums[:, w] = t, 0.0, 0.0
        normal = normal_equations_over(states, h, ones, v, ones)
        respond(windows, t - starts, normal, after, after[states], True)
        old = np.flatnonzero(t - starts >= YOUNGEST_S).tolist()
        if any(ramp_ratio(windows, w, i, 0.0) > threshold for w in old for i in range(count)):
            if k >= onset:
                return k - onset, false
            false.append(k)
            d[:], sums[:], starts[:] = 0.0, 0.0, t + dt
        error = error - gain @ v + kick @ drift[k]
    return -1, false


def ramps() -> None:
    """Delays of the tests with memory."""
    threshold = chi_square_threshold(1, 1e-4 / 10)
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
