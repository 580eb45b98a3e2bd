"""Where redundancy allows: the least range error that can be detected and isolated, and what was.

Run by hand: `python benchmarks/gnss_redundancy.py SETS.yaml [METRES]`, a list as of
`gnss_held_back.py`, whose trials these are. Of each faulted epoch the least error of the faulty
satellite that its own test [1]_ detects with the detector's false-alarm probability over the number
of satellites, and that is larger than the most similar satellite's statistic, both in 99 of 100
epochs; from the satellites of that epoch alone, with the noise that the recording shows.

References
----------
.. [1] W. Baarda, A testing procedure for use in geodetic networks, 1968.
"""

import math
import sys
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from gnss_held_back import EDGE_S, FAULT_S, TRIALS, decide, with_fault
from msgspec.structs import replace

from analysis.detection import Detector, DetectorConfig
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.detection.learn_noise import learn_noise
from analysis.detection.stages.initial_fix import solve_snapshot
from analysis.orbits.broadcast import design_matrix
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample, Sample
from mavproxy_fault.documents.yaml_document import read_document

SURE = NormalDist().inv_cdf(0.99)


def least_errors(samples: list[Sample], config: DetectorConfig) -> dict[tuple[int, str], float]:
    """The least error in m that is detected and isolated, by epoch and satellite."""
    broadcast, x, out = Detector(config).new_state().core.broadcast, np.zeros(X_SIZE), {}
    for s in samples:
        if isinstance(s, (EphemerisSample, IonosphereSample)):
            broadcast = broadcast.add(s)
        elif isinstance(s, Epoch):
            selection = select_ephemerides(s, broadcast.ephemerides, config.systems)
            observation = observe_epoch(s, selection)
            found = observation and solve_snapshot(observation, x, config, broadcast.ionosphere)
            if observation is None or found is None:
                continue
            x = found
            used = predict_innovations(observation, x, config.sigma, broadcast.ionosphere)
            above = used.elevation_rad >= config.mask_rad
            observation, used = observation.select(above), used.select(above)
            a = design_matrix(-used.geometry[:, :3], observation.measurements.system)
            if len(a) <= a.shape[1]:
                continue
            weight = 1.0 / used.variance
            left = np.diag(used.variance) - a @ np.linalg.inv((a.T * weight) @ a) @ a.T
            own = np.sqrt(np.maximum(np.diag(left), 1e-12)) * weight
            alike = np.abs(left * np.outer(weight, weight) / np.outer(own, own))
            np.fill_diagonal(alike, 0.0)
            detected = NormalDist().inv_cdf(1.0 - config.p_false_alarm / 2.0 / len(a)) + SURE
            for i, name in enumerate(observation.satellites):
                isolated = SURE * math.sqrt(2.0 / max(1.0 - alike[i].max(), 1e-9))
                out[s.t_us, name] = max(detected, isolated) / own[i]
    return out


def row(given: Any, folder: Path, systems: str, size_m: float) -> str:
    """The line of a recording."""
    samples = read_rinex_samples(folder / given["obs"], [folder / name for name in given["nav"]])
    config = DetectorConfig(systems=systems)
    learnt = learn_noise(samples, config)
    config = replace(config, sigma=learnt.sigma) if learnt else config
    clean, least = decide(samples, config), least_errors(samples, config)
    usual = {d.t_us: set(d.excluded) for d in clean if d.position_ecef_m}
    seen = [name for d in clean for name in set(d.satellites) - set(d.excluded)]
    often = sorted(name for name in set(seen) if seen.count(name) > 0.9 * len(clean))
    room_us = clean[-1].t_us - clean[0].t_us - (FAULT_S + 2.0 * EDGE_S) * 1e6
    rng, cases = np.random.default_rng(1), []
    for _ in range(TRIALS if often and room_us > 0 else 0):
        name = str(rng.choice(often))
        from_us = int(clean[0].t_us + EDGE_S * 1e6 + rng.uniform(0.0, room_us))
        for d in decide(with_fault(samples, name, size_m, from_us), config):
            since_s = (d.t_us - from_us) * 1e-6
            if 0.0 <= since_s < FAULT_S and d.t_us in usual:
                right = set(d.excluded) == usual[d.t_us] | {name}
                cases.append((right, least.get((d.t_us, name), math.inf) <= size_m, since_s < 45.0))
    if not cases:
        return f"| {given['name']}, {systems} | 0 | - | - | - | - |"
    right, redundant, early = np.array(cases).T
    cells = [f"{100 * right.mean():.0f}", f"{100 * redundant.mean():.0f}"]
    for among in (redundant, redundant & early):
        cells.append(f"{100 * right[among].mean():.1f}" if among.any() else "-")
    return f"| {given['name']}, {systems} | {len(cases)} | {' | '.join(cells)} |"


if __name__ == "__main__":
    path, metres = Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
    print(
        "| recording, systems | faulted epochs | right, % | redundancy allows it, %"
        " | right there, % | in the first 45 s of a fault, % |"
    )
    print("|---" * 6 + "|", flush=True)
    for each in read_document(path).data:
        for letters in each["systems"]:
            print(row(each, path.parent, letters, metres), flush=True)
