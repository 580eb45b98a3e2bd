"""Recordings with a truth: error over its own sigma, levels, and both by a calibration on one half.

Run by hand: `python benchmarks/gnss_sigma.py SETS.yaml...`; SETS.yaml as for `gnss_sets.py`. The
second half of each recording is judged by the sigma model that `monitor --calibrate` finds in the
first.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gnss_sets import Recording, recordings
from msgspec.structs import replace

from analysis.detection import DetectorConfig
from analysis.detection.calibrate import calibrate
from analysis.detection.detector import Detector, run
from analysis.recordings.recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch, Sample


def row(recording: Recording) -> str:
    """The line of a recording."""
    samples = read_rinex_samples(recording.obs, recording.nav)
    stamps = [s.t_us for s in samples if isinstance(s, Epoch)]
    middle_us = (stamps[0] + stamps[-1]) // 2
    config = DetectorConfig(systems=recording.systems)
    found = calibrate(part(samples, 0, middle_us), config)
    fitted = replace(config, sigma=found.sigma)
    cells = [
        judged(recording, samples, config),
        judged(recording, part(samples, middle_us, stamps[-1] + 1), fitted),
    ]
    return f"| {recording.name}, {recording.systems} | {len(stamps)} | {' | '.join(cells)} |"


def part(samples: Sequence[Sample], from_us: int, until_us: int) -> list[Sample]:
    """The samples of a stretch, with every orbit."""
    return [s for s in samples if not isinstance(s, Epoch) or from_us <= s.t_us < until_us]


def judged(recording: Recording, samples: Sequence[Sample], config: DetectorConfig) -> str:
    """Alarms; error over sigma at 50 and 95 %; chi-square per degree of freedom; the levels and how
    often an error was above one."""
    decisions = [r for r in run(Detector(config), samples) if isinstance(r, Decision)]
    ratios, levels, above = [], [], 0
    for decision in decisions:
        true_m = recording.truth.at(decision.t_us)
        bounded = decision.position_ecef_m is not None and decision.position_sigma_m is not None
        if true_m is None or not bounded:
            continue
        off_m = np.subtract(decision.position_ecef_m, true_m)
        ratios.append(np.linalg.norm(off_m) / np.linalg.norm(decision.position_sigma_m))
        if decision.hpl_m is not None and decision.vpl_m is not None:
            up = true_m / np.linalg.norm(true_m)
            vertical_m = abs(off_m @ up)
            horizontal_m = np.sqrt(max(off_m @ off_m - vertical_m**2, 0.0))
            levels.append((decision.hpl_m, decision.vpl_m))
            above += horizontal_m > decision.hpl_m or vertical_m > decision.vpl_m
    dof = sum(d.parity_dof for d in decisions)
    per_dof = sum(d.parity_statistic or 0.0 for d in decisions) / max(dof, 1)
    half, most = np.percentile(ratios or [np.nan], [50, 95])
    level = "none, -" if not levels else ", ".join(f"{m:.1f}" for m in np.median(levels, axis=0))
    alarms = sum(decision.alarm for decision in decisions)
    return f"{alarms} | {half:.2f} / {most:.2f} | {per_dof:.2f} | {level} | {above}"


if __name__ == "__main__":
    cells = "alarms | error over sigma, 50 / 95 % | chi-square per dof | levels, m | above"
    print(f"| recording | epochs | {cells} | second half, calibrated: {cells} |")
    print("|---" * 12 + "|")
    for path in sys.argv[1:]:
        for each in recordings(Path(path)):
            print(row(each), flush=True)
