"""Recordings x spoofers: when the detector sees one, what it says, and where it believes to be.

Run by hand: `python benchmarks/gnss_spoofs.py SETS.yaml`; SETS.yaml as for `gnss_sets.py`. Every
fault is put into the observation file as `replay --nav` puts it, 100 s after the first epoch (a
third of the recording where it is shorter than 300 s) for two minutes or what there is.
"""

import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gnss_sets import Recording, recordings, stanford

from analysis.detection import DetectorConfig
from analysis.detection.sensors.jamming_detector import JammingDetector
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision, SensorDecision
from analysis.samples.block import split_at_events
from analysis.scoring.integrity import Integrity
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.schedule.entries import parse_schedule

AT_S, FOR_S = 100.0, 120.0


def _ramp(target: str, rate: float) -> dict[str, Any]:
    segments = [{"at_s": 0, "for_s": FOR_S, "start": 0, "rate": rate}]
    return {"fault": "plant", "target": f"PLANT.{target}", "profile": {"segments": segments}}


def _step(target: str, value: float) -> dict[str, Any]:
    return {"fault": "plant", "target": f"PLANT.{target}", "value": value}


SPOOFS: dict[str, list[dict[str, Any]]] = {
    "none": [],
    "Galileo's clock runs away at 0.9 m/s, ranges alone": [
        {"fault": "drift", "target": [f"PSEUDORANGE.E{n:02d}" for n in range(1, 37)], "value": 0.9}
    ],
    "Galileo's clock runs away at 0.9 m/s, Doppler too": [_ramp("spoof_clock_m[E]", 0.9)],
    "Galileo's clock jumps by 50 m": [_step("spoof_clock_m[E]", 50.0)],
    "GPS jumps by 30 m": [_step("spoof_north_m[G]", 30.0)],
    "GPS jumps by 200 m": [_step("spoof_north_m[G]", 200.0)],
    "Galileo jumps by 30 m": [_step("spoof_north_m[E]", 30.0)],
    "GPS carried off at 1 m/s": [_ramp("spoof_north_m[G]", 1.0)],
    "GPS carried off at 5 m/s": [_ramp("spoof_north_m[G]", 5.0)],
    "Galileo carried off at 1 m/s": [_ramp("spoof_north_m[E]", 1.0)],
    "both carried off at 1 m/s": [_ramp("spoof_north_m[all]", 1.0)],
    "preset gnss-carry-off (all, 5 m/s)": [{"preset": "gnss-carry-off"}],
    "preset gnss-spoof-jump (all, 200 m)": [{"preset": "gnss-spoof-jump"}],
    "preset gnss-meaconing (all, 150 m, 1 us)": [{"preset": "gnss-meaconing"}],
    "preset gnss-time-spoof (all, 30 m/s)": [{"preset": "gnss-time-spoof"}],
    "preset gps-jamming (all, 20 dB)": [{"preset": "gps-jamming"}],
    "preset gnss-jamming-growing (all, 1 dB/s)": [{"preset": "gnss-jamming-growing"}],
    "Doppler of one satellite 5 m/s wrong": [_step("range_rate_mps[{one}]", 5.0)],
}


class Answer(NamedTuple):
    """Seconds to the first alarm, the most frequent alarms (with their exclusions), the largest
    error while a sigma bounded it and while none did, share of epochs during the fault with a
    position, and the counts of protection levels during the fault."""

    alarm_s: float | None
    verdict: str
    bounded_m: float
    unbounded_m: float
    share: float
    levels: str


def answer(recording: Recording, faults: list[dict[str, Any]], at_s: float) -> Answer:
    """The detector's answer to one spoof."""
    entries = [{**fault, "at_s": at_s, "for_s": FOR_S} for fault in faults]
    schedule = parse_schedule({"faults": entries})
    lines, _labels = faulted_lines(recording.obs, schedule, recording.nav)
    references = NavigationDetector(DetectorConfig(systems=recording.systems))
    state, found = references.new_state(), []
    block = read_rinex(recording.obs, recording.nav, None, lines)
    for piece in split_at_events(block):
        results, state = references.step_piece(piece, state)
        found += results
    watch = JammingDetector()
    beside = [result for _, result in watch.step(block, watch.new_state())[0]]
    beside += [result for result in found if isinstance(result, SensorDecision)]
    decisions = [result for result in found if isinstance(result, Decision)]
    begin_us = decisions[0].t_us + at_s * 1e6
    end_us = begin_us + FOR_S * 1e6
    acting = [d for d in decisions if begin_us <= d.t_us < end_us]
    alarms = [d.t_us for d in acting if d.alarm or d.hypothesis not in ("none", "untestable")]
    sensor_alarms = [d for d in beside if begin_us <= d.t_us < end_us and d.alarm]
    alarms = sorted(alarms + [d.t_us for d in sensor_alarms])
    bounded, unbounded = [0.0], [0.0]
    for decision in acting:
        true_m = recording.truth.at(decision.t_us)
        if decision.position_ecef_m is not None and true_m is not None:
            error_m = float(np.linalg.norm(np.array(decision.position_ecef_m) - true_m))
            (unbounded if decision.position_sigma_m is None else bounded).append(error_m)
    integrity = Integrity(recording.truth)
    integrity.add(acting)
    placed = sum(decision.position_ecef_m is not None for decision in acting)
    return Answer(
        (alarms[0] - begin_us) * 1e-6 if alarms else None,
        _alarm_counts(acting, sensor_alarms),
        max(bounded),
        max(unbounded),
        placed / max(len(acting), 1),
        stanford([integrity]),
    )


def _alarm_counts(acting: list[Decision], sensor_alarms: list[SensorDecision]) -> str:
    """The hypotheses with the excluded systems, and alarms of sensor tests, the most frequent
    first."""
    counts = Counter(_words(decision) for decision in acting)
    counts.update("Doppler of one" if d.suspect else d.reason.split(":")[0] for d in sensor_alarms)
    return ", ".join(f"{words} {count}" for words, count in counts.most_common(4))


def _words(decision: Decision) -> str:
    by_system = Counter(name[0] for name in decision.excluded)
    left_out = "+".join(f"{count} {letter}" for letter, count in sorted(by_system.items()))
    return decision.hypothesis + (f" ({left_out})" if left_out else "")


def main(path: Path) -> None:
    """The table of every recording in a list."""
    for recording in recordings(path):
        samples = [s for s in read_rinex(recording.obs, recording.nav).samples()]
        epochs = [s for s in samples if hasattr(s, "tow_s")]
        span_s = (epochs[-1].t_us - epochs[0].t_us) * 1e-6
        at_s = min(AT_S, span_s / 3.0)
        print(f"\n## {recording.name}, {recording.systems}\n")
        print(
            "| spoof | alarm, s | epochs by verdict | error with sigma, m | without | position"
            " | errors above their level, horizontal | vertical |"
        )
        print("|---" * 8 + "|")
        for title, faults in SPOOFS.items():
            one = next(name for name in epochs[0].satellites if name[0] in "GE")
            named = [{k: _with(v, one) for k, v in fault.items()} for fault in faults]
            found = answer(recording, named, at_s)
            alarm = "-" if found.alarm_s is None else f"{found.alarm_s:.0f}"
            print(
                f"| {title} | {alarm} | {found.verdict} | {found.bounded_m:.1f}"
                f" | {found.unbounded_m:.1f} | {100.0 * found.share:.0f} % | {found.levels} |",
                flush=True,
            )


def _with(value: Any, one: str) -> Any:
    return value.replace("{one}", one) if isinstance(value, str) else value


if __name__ == "__main__":
    main(Path(sys.argv[1]))
