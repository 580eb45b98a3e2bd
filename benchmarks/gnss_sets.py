"""Recordings x faults: the detector, RTKLIB with RAIM FDE on the same files, and the fusion.

Run by hand: `python benchmarks/gnss_sets.py SETS.yaml [TRIALS]`. SETS.yaml lists recordings:

    - {name: roof, obs: SEPT078M.21O, nav: [SEPT078M.21P], truth: "X,Y,Z", systems: [G, GE]}

Paths count from the list's folder; `truth` is what `monitor --truth` takes. Every fault is put into
the observation file by the proxy's engine (`replay`), so that anybody gets the same files. An epoch
is right where exactly the faulty satellites are left out beside those that are without the fault,
and near where its position is within 1 m of its own without the fault; RTKLIB's is right where it
is near. The last two columns are a Stanford diagram's counts, clean or of all trials: see
`stanford`.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from analysis.detection import DetectorConfig
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.smoother import Fusion
from analysis.recordings.position_reference import PositionReference, read_reference
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision, FusedState
from analysis.samples.block import EPOCH, split_at_events
from analysis.scoring.integrity import ALERT_LIMITS_M, ERROR, LEVEL, Integrity
from analysis.scoring.position_scores import PositionScores
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.rinex.rinex_text import read_rinex_text
from mavproxy_fault.schedule.entries import parse_schedule

FAULT_S, EDGE_S = 60.0, 20.0
NEAR_M = 1.0
SAME_US = 20_000
FAULTS: dict[str, tuple[int, str, float]] = {  # how many satellites, fault, value
    "50 m step": (1, "bias", 50.0),
    "20 m step": (1, "bias", 20.0),
    "0.5 m/s ramp": (1, "drift", 0.5),
    "50 m on two": (2, "bias", 50.0),
    "50 m on three": (3, "bias", 50.0),
}
SYSTEMS = {"G": 1, "E": 8, "R": 4, "C": 32}  # RTKLIB's bits
Places = dict[int, Any]


class Recording(NamedTuple):
    """One line of the list."""

    name: str
    obs: Path
    nav: list[Path]
    truth: PositionReference
    systems: str


class Found(NamedTuple):
    """What one pass over a recording gave: exclusions and positions by stamp, and the satellites in
    use in nine epochs of ten."""

    often: list[str]
    excluded: dict[int, frozenset[str]]
    filtered: Places
    alarms: int
    scores: PositionScores
    integrity: Integrity


def recordings(path: Path) -> Iterable[Recording]:
    """Those of a list, once for each choice of systems."""
    for row in read_document(path).data:
        for systems in row["systems"]:
            nav = [path.parent / name for name in row["nav"]]
            truth = row["truth"]
            given = truth if truth.count(",") == 2 else str(path.parent / truth)
            reference = read_reference(given)
            yield Recording(row["name"], path.parent / row["obs"], nav, reference, systems)


def judged(recording: Recording, lines: list[str]) -> Found:
    """The detector with the fusion behind it."""
    config = DetectorConfig(systems=recording.systems)
    references, fusion = NavigationDetector(config), Fusion(FusionConfig(), config)
    detecting, fusing = references.new_state(), fusion.new_state()
    excluded, filtered, alarms, scores = {}, {}, 0, PositionScores()
    integrity = Integrity(recording.truth)
    counts: dict[str, int] = {}
    for piece in split_at_events(read_rinex(recording.obs, recording.nav, None, lines)):
        results, detecting = references.step_piece(piece, detecting)
        fused, fusing = fusion.step(piece, results, detecting.detector.core, fusing)
        integrity.add(results)
        for result in (*results, *fused):
            if not isinstance(result, (Decision, FusedState)) or result.position_ecef_m is None:
                continue
            true_m, name = recording.truth.at(result.t_us), "fused"
            if isinstance(result, Decision):
                excluded[result.t_us], name = frozenset(result.excluded), "filter"
                filtered[result.t_us] = result.position_ecef_m
                alarms += result.alarm
                for satellite in set(result.satellites) - excluded[result.t_us]:
                    counts[satellite] = counts.get(satellite, 0) + 1
            if true_m is not None and result.t_us in filtered:  # both, or the filter alone
                where = result.position_ecef_m, result.position_sigma_m, true_m
                scores.add(name, *where)
    often = sorted(name for name, count in counts.items() if count > 0.9 * len(filtered))
    return Found(often, excluded, filtered, alarms, scores, integrity)


def stanford(trials: Iterable[Integrity]) -> str:
    """Two cells, horizontal and vertical: errors above their level of the epochs with both, the
    largest error over its level, and how many levels are within the alert limit, with an error
    above that limit."""
    kept, cells = list(trials), []
    for direction, limit_m in ALERT_LIMITS_M.items():
        table = np.vstack([each.table(direction) for each in kept])
        error, level = table[:, ERROR], table[:, LEVEL]
        within = level <= limit_m
        most = f"{(error / level).max():.2f}" if len(table) else "-"
        cells.append(
            f"{(error > level).sum()} of {len(table)}, {most}; {within.sum()} within"
            f" {limit_m:.0f} m, {(error[within] > limit_m).sum()} of them hazardous"
        )
    return " | ".join(cells)


def rtklib(recording: Recording, lines: list[str], stamps: list[int]) -> Places:
    """Positions of rnx2rtkp's single-point solution with RAIM FDE by the stamps of the epochs."""
    with tempfile.TemporaryDirectory() as folder:
        obs, options = Path(folder, "a.obs"), Path(folder, "a.conf")
        out = Path(folder, "a.pos")
        obs.write_text("\n".join(lines) + "\n", errors="replace")
        systems = sum(SYSTEMS[letter] for letter in recording.systems)
        options.write_text(
            "pos1-posmode=single\npos1-elmask=10\npos1-ionoopt=brdc\npos1-tropopt=saas\n"
            f"pos1-navsys={systems}\npos1-posopt5=on\nout-solformat=xyz\nout-timeform=tow\n"
        )
        command = ["rnx2rtkp", "-k", options, "-o", out, obs, *recording.nav]
        subprocess.run(command, check=True, capture_output=True)
        if not any(not line.startswith("%") for line in out.read_text().splitlines()):
            return {}
        found = read_reference(str(out))
    # Its times exclude the receiver's clock error, which is milliseconds on some.
    wanted_us, known = np.array(stamps), found.t_us
    nearest = known[np.abs(known[:, None] - wanted_us).argmin(axis=0)]
    return {
        t_us: found.r_ecef_m[np.searchsorted(known, at)]
        for t_us, at in zip(stamps, nearest.tolist(), strict=True)
        if abs(t_us - at) < SAME_US
    }


def row(recording: Recording, trials: int) -> None:
    """The lines of the table of one recording."""
    healthy = read_rinex_text(recording.obs)
    block = read_rinex(recording.obs, recording.nav)
    stamps = block.t_us[block.rows(EPOCH)].tolist()
    clean, theirs = judged(recording, healthy), rtklib(recording, healthy, stamps)
    scores = clean.scores.summary()
    rtk = PositionScores()
    for t_us, place in theirs.items():
        if (true_m := recording.truth.at(t_us)) is not None:
            rtk.add("rtklib", place, None, true_m)
    ours = scores.get("filter", {})
    per_hour = 3600e6 * clean.alarms / (stamps[-1] - stamps[0])
    print(
        f"| {recording.name}, {recording.systems} | clean | {len(stamps)} epochs,"
        f" {len(clean.filtered)} tested, {clean.alarms} alarms ({per_hour:.0f} an hour)"
        f" | {ours.get('horizontal_50_m')} / {ours.get('horizontal_95_m')}"
        f" | {_percentiles(rtk)} | {_ratio(clean.scores)}"
        f" | {ours.get('over_sigma_50')} / {ours.get('over_sigma_95')}"
        f" | {stanford([clean.integrity])} |",
        flush=True,
    )
    span_s = (stamps[-1] - stamps[0]) * 1e-6
    if len(clean.often) < 3 or span_s < FAULT_S + 2.0 * EDGE_S:
        return
    rng = np.random.default_rng(1)
    for title, (count, fault, value) in FAULTS.items():
        right, near, our_total, their_right, their_total, ratios = 0, 0, 0, 0, 0, []
        levels: list[Integrity] = []
        for _ in range(trials):
            names = rng.choice(clean.often, count, replace=False).tolist()
            at_s = float(np.floor(rng.uniform(EDGE_S, span_s - FAULT_S - EDGE_S)))
            entry = {"fault": fault, "value": value, "at_s": at_s, "for_s": FAULT_S}
            entry["target"] = [f"PSEUDORANGE.{name}" for name in names]
            lines, _labels = faulted_lines(recording.obs, parse_schedule({"faults": [entry]}))
            found, rtk_found = judged(recording, lines), rtklib(recording, lines, stamps)
            first = stamps[0] + at_s * 1e6
            acting = [t for t in stamps if first <= t < first + FAULT_S * 1e6]
            wanted = frozenset(names)
            for t_us in acting:
                if t_us in clean.excluded:
                    our_total += 1
                    right += found.excluded.get(t_us) == clean.excluded[t_us] | wanted
                    near += _near(found.filtered.get(t_us), clean.filtered[t_us])
                if t_us in theirs:
                    their_total += 1
                    their_right += _near(rtk_found.get(t_us), theirs[t_us])
            ratios.append(_ratio(found.scores))
            levels.append(found.integrity)
        shares = 100 * np.array([right, near]) / max(our_total, 1)
        cells = f"{shares[0]:.0f} %, near {shares[1]:.0f} %"
        other = f"{100 * their_right / max(their_total, 1):.0f} %"
        known = [ratio for ratio in ratios if ratio is not None]
        worst = f"{np.median(known):.2f}, most {max(known):.2f}" if known else "-"
        print(
            f"| | {title} | {trials} trials | {cells} | {other} | {worst} | | {stanford(levels)} |",
            flush=True,
        )


def _near(place: Any, clean: Any) -> bool:
    """Whether a position is where it is without the fault."""
    return place is not None and bool(np.linalg.norm(np.subtract(place, clean)) < NEAR_M)


def _percentiles(scores: PositionScores) -> str:
    found = scores.summary().get("rtklib", {})
    return f"{found.get('horizontal_50_m')} / {found.get('horizontal_95_m')}"


def _ratio(scores: PositionScores) -> float | None:
    """Root mean square error of the fused position over the filter's."""
    fused, filtered = scores.rmse_m("fused"), scores.rmse_m("filter")
    return round(fused / filtered, 2) if fused and filtered else None


if __name__ == "__main__":
    number = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    print(
        "| recording, systems | fault | | epochs right; clean: horizontal error 50 / 95 %, m"
        " | RTKLIB the same | fused / filter | error over sigma 50 / 95 % | errors above their"
        " level, horizontal | vertical |"
    )
    print("|---" * 9 + "|")
    for each in recordings(Path(sys.argv[1])):
        row(each, number)
