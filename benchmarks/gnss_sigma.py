"""Recordings with a truth: error over its own sigma, levels, and both by a calibration on one half.

Run by hand: `python benchmarks/gnss_sigma.py SETS.yaml...`; SETS.yaml as for `gnss_sets.py`. The
second half of each recording is judged by the sigma model that `monitor --calibrate` finds in the
first. A second table says where errors are above three sigmas.
"""

import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from gnss_sets import Recording, recordings
from msgspec.structs import replace

from analysis.detection import DetectorConfig
from analysis.detection.detector import Detector, run_detector
from analysis.detection.learn_noise import learn_noise
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch, Sample

OUTSIDE = 3.0


def row(recording: Recording) -> str:
    """The line of a recording."""
    samples = read_rinex_samples(recording.obs, recording.nav)
    stamps = [s.t_us for s in samples if isinstance(s, Epoch)]
    middle_us = (stamps[0] + stamps[-1]) // 2
    config = DetectorConfig(systems=recording.systems)
    cells = [judged(recording, samples, config)]
    found = learn_noise(part(samples, 0, middle_us), config)
    if found is None:  # too few epochs
        cells.append("- | - | - | - | -")
    else:
        fitted = replace(config, sigma=found.sigma)
        cells.append(judged(recording, part(samples, middle_us, stamps[-1] + 1), fitted))
    return f"| {recording.name}, {recording.systems} | {len(stamps)} | {' | '.join(cells)} |"


def part(samples: Sequence[Sample], from_us: int, until_us: int) -> list[Sample]:
    """The samples of a stretch, with every orbit."""
    return [s for s in samples if not isinstance(s, Epoch) or from_us <= s.t_us < until_us]


class Error(NamedTuple):
    """An epoch's error against the truth: its length, its horizontal and vertical part and their
    sigma in m, and whether the filter started with it."""

    all_m: float
    horizontal_m: float
    vertical_m: float
    sigma_m: float
    start: bool


def errors_of(recording: Recording, decisions: Sequence[Decision]) -> list[tuple[Decision, Error]]:
    """The epochs that have a truth, a position and a sigma."""
    found = []
    for decision in decisions:
        true_m = recording.truth.at(decision.t_us)
        bounded = decision.position_ecef_m is not None and decision.position_sigma_m is not None
        if true_m is None or not bounded:
            continue
        off_m = np.subtract(decision.position_ecef_m, true_m)
        vertical_m = abs(float(off_m @ true_m)) / float(np.linalg.norm(true_m))
        horizontal_m = float(np.sqrt(max(off_m @ off_m - vertical_m**2, 0.0)))
        sigma_m = float(np.linalg.norm(decision.position_sigma_m))
        all_m = float(np.linalg.norm(off_m))
        error = Error(all_m, horizontal_m, vertical_m, sigma_m, decision.mode == "start")
        found.append((decision, error))
    return found


def judged(recording: Recording, samples: Sequence[Sample], config: DetectorConfig) -> str:
    """Alarms; error over sigma at 50 and 95 %; chi-square per degree of freedom; the levels and how
    often an error was above one."""
    decisions = [r for r in run_detector(Detector(config), samples) if isinstance(r, Decision)]
    ratios, levels, above = [], [], 0
    for decision, error in errors_of(recording, decisions):
        ratios.append(error.all_m / error.sigma_m)
        if decision.hpl_m is not None and decision.vpl_m is not None:
            levels.append((decision.hpl_m, decision.vpl_m))
            above += error.horizontal_m > decision.hpl_m or error.vertical_m > decision.vpl_m
    dof = sum(d.parity_dof for d in decisions)
    per_dof = sum(d.parity_statistic or 0.0 for d in decisions) / max(dof, 1)
    half, most = np.percentile(ratios or [np.nan], [50, 95])
    level = "none, -" if not levels else ", ".join(f"{m:.1f}" for m in np.median(levels, axis=0))
    alarms = sum(decision.alarm for decision in decisions)
    return f"{alarms} | {half:.2f} / {most:.2f} | {per_dof:.2f} | {level} | {above}"


def outside(recording: Recording) -> str:
    """The line of a recording about its errors above three sigmas."""
    samples = read_rinex_samples(recording.obs, recording.nav)
    detector = Detector(DetectorConfig(systems=recording.systems))
    decisions = [r for r in run_detector(detector, samples) if isinstance(r, Decision)]
    errors = [error for _, error in errors_of(recording, decisions)]
    far = [error.all_m > OUTSIDE * error.sigma_m for error in errors]
    runs = [len(list(same)) for is_far, same in groupby(far) if is_far]
    beyond = [error for error, is_far in zip(errors, far, strict=True) if is_far]
    middle = np.median(beyond, axis=0)[:4] if beyond else []
    starts = [error.all_m / error.sigma_m for error in errors if error.start]
    at_start = "{:.1f} / {:.1f}".format(*np.percentile(starts, [50, 95])) if starts else "-"
    there = [f"{metres:.1f}" for metres in middle] or 4 * ["-"]
    return (
        f"| {recording.name}, {recording.systems} | {len(errors)} | {len(beyond)} "
        f"| {len(runs)}, {max(runs, default=0)} | {', '.join(there[:3])} | {there[3]}"
        f" | {len(starts)}: {at_start} |"
    )


if __name__ == "__main__":
    cells = "alarms | error over sigma, 50 / 95 % | chi-square per dof | levels, m | above"
    print(f"| recording | epochs | {cells} | second half, calibrated: {cells} |")
    print("|---" * 12 + "|")
    every = [each for path in sys.argv[1:] for each in recordings(Path(path))]
    for each in every:
        print(row(each), flush=True)
    print(
        "\n| recording | epochs with a truth | errors above three sigmas | stretches, longest ",
        end="",
    )
    print("| error there: all, horizontal, vertical, m | sigma there, m | starts: over sigma |")
    print("|---" * 7 + "|")
    for each in every:
        print(outside(each), flush=True)
