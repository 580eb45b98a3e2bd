"""Recordings that nothing was tuned to: with the noise that each shows, and with the model's own.

Run by hand: `python benchmarks/gnss_held_back.py SETS.yaml`, a list as of `gnss_sets.py` whose
`truth` may be missing and whose `obs` may be a receiver's log. Of each recording: the epochs with a
position, epochs with an unexplained alarm, the longest time that a satellite stays excluded, the
horizontal error, error over sigma, errors above their level; then one satellite in use with 50 and
10 m for a minute, in five trials: the share of epochs at which it and no other is excluded beside
those of the clean run. RTKLIB's single-point solution with RAIM FDE in the same run.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gnss_sets import Recording, rtklib
from msgspec.structs import replace as with_fields

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.learn_noise import learn_noise
from analysis.recordings.gnss.receiver_logs import is_receiver_log
from analysis.recordings.position_reference import read_reference
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch, Sample
from analysis.scoring.integrity import ERROR, LEVEL, Integrity
from analysis.scoring.position_scores import PositionScores
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.rinex.rinex_text import read_rinex_text

TRIALS, FAULT_S, EDGE_S = 5, 60.0, 20.0


def decide(samples: list[Sample], config: DetectorConfig) -> list[Decision]:
    """The decisions on a recording."""
    return [r for r in run_detector(Detector(config), samples) if isinstance(r, Decision)]


def with_fault(samples: list[Sample], name: str, size_m: float, from_us: int) -> list[Sample]:
    """The samples with metres on a satellite's range for a minute."""
    out = []
    for sample in samples:
        if isinstance(sample, Epoch) and 0 <= sample.t_us - from_us < FAULT_S * 1e6:
            shift = size_m * np.array([one == name for one in sample.satellites])
            sample = replace(sample, pseudorange_m=sample.pseudorange_m + shift)
        out.append(sample)
    return out


def longest_exclusion_s(found: list[Decision]) -> str:
    """The satellite that is excluded longest at a stretch, and for how long."""
    since, longest = {}, (0.0, "-")
    for decision in found:
        since = {name: since.get(name, decision.t_us) for name in decision.excluded}
        for name, at_us in since.items():
            longest = max(longest, ((decision.t_us - at_us) * 1e-6, name))
    return f"{longest[1]} {longest[0]:.0f}" if longest[0] else "-"


def isolated(samples: list[Sample], clean: list[Decision], size_m: float, config: Any) -> str:
    """The share of faulted epochs with exactly the faulty satellite excluded, over trials."""
    usual = {d.t_us: set(d.excluded) for d in clean if d.position_ecef_m}
    counts: dict[str, int] = {}
    for decision in clean:
        for name in set(decision.satellites) - set(decision.excluded):
            counts[name] = counts.get(name, 0) + 1
    often = sorted(name for name, count in counts.items() if count > 0.9 * len(clean))
    first_us, last_us = clean[0].t_us, clean[-1].t_us
    room_us = last_us - first_us - (FAULT_S + 2.0 * EDGE_S) * 1e6
    if not often or room_us <= 0:
        return "-"
    rng, right, total = np.random.default_rng(1), 0, 0
    for _ in range(TRIALS):
        name = str(rng.choice(often))
        from_us = int(first_us + EDGE_S * 1e6 + rng.uniform(0.0, room_us))
        for decision in decide(with_fault(samples, name, size_m, from_us), config):
            if 0 <= decision.t_us - from_us < FAULT_S * 1e6 and decision.t_us in usual:
                total += 1
                right += set(decision.excluded) == usual[decision.t_us] | {name}
    return f"{100 * right / max(total, 1):.0f}"


def row(given: Any, folder: Path, systems: str) -> str:
    """The line of a recording."""
    obs, nav = folder / given["obs"], [folder / name for name in given["nav"]]
    truth = read_reference(given["truth"]) if given.get("truth") else None
    samples = read_rinex_samples(obs, nav)
    model = DetectorConfig(systems=systems)
    learnt = learn_noise(samples, model)
    fitted = with_fields(model, sigma=learnt.sigma) if learnt else model
    before, found = decide(samples, model), decide(samples, fitted)
    cells = [f"{given['name']}, {systems}", str(len(found))]
    cells.append(f"{sum(d.position_ecef_m is not None for d in found)}")
    shares = [
        100 * sum(d.hypothesis == "multiple-unknown" for d in one) / len(one)
        for one in (before, found)
    ]
    cells += [f"{shares[0]:.1f} -> {shares[1]:.1f}", longest_exclusion_s(found)]
    scores, rtk, integrity = PositionScores(), PositionScores(), Integrity(truth)
    theirs: dict[int, Any] = {}
    if truth is not None:
        integrity.add(found)
        for d in found:
            at = truth.at(d.t_us)
            if at is not None and d.position_ecef_m and d.position_sigma_m:
                scores.add("filter", d.position_ecef_m, d.position_sigma_m, at)
    if not is_receiver_log(obs):
        recording = Recording(given["name"], obs, nav, truth, systems)
        theirs = rtklib(recording, read_rinex_text(obs), [d.t_us for d in found])
        for t_us, place in theirs.items():
            if truth is not None and (at := truth.at(t_us)) is not None:
                rtk.add("rtklib", place, None, at)
    ours, other = scores.summary().get("filter"), rtk.summary().get("rtklib")
    for one in (ours, other):
        cells.append(f"{one['horizontal_50_m']} / {one['horizontal_95_m']}" if one else "-")
    cells.append(str(len(theirs)) if theirs else "-")
    cells.append(f"{ours['over_sigma_50']} / {ours['over_sigma_95']}" if ours else "-")
    tables = [integrity.table(way) for way in ("horizontal", "vertical")] if ours else []
    ratios = [f"{(t[:, ERROR] / t[:, LEVEL]).max():.2f}" for t in tables if len(t)]
    cells.append(" / ".join(ratios) or "-")
    cells += [isolated(samples, found, size_m, fitted) for size_m in (50.0, 10.0)]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    print(
        "| recording, systems | epochs | with a position | unexplained, %: model -> learnt"
        " | longest exclusion, s | horizontal error 50 / 95 %, m | RTKLIB's | RTKLIB's epochs"
        " | error over sigma 50 / 95 % | largest error over level, h / v | 50 m, % | 10 m, % |"
    )
    print("|---" * 12 + "|", flush=True)
    path = Path(sys.argv[1])
    for each in read_document(path).data:
        for letters in each["systems"]:
            print(row(each, path.parent, letters), flush=True)
