"""One and two frequencies on recordings: accuracy, bounds, exclusions, and planted faults.

Run by hand: `python benchmarks/two_frequencies.py SETS.yaml`, a list as of `gnss_sets.py`. Each
recording is run with the range on one frequency and with the ionosphere-free combination, with the
noise that it shows; the difference of the two ranges is tested in both. Of each: the horizontal
and vertical error, error over sigma, the largest error over its level, epochs that exclude a
satellite, alarms of the difference; RTKLIB's single-point solution of the same frequencies; then
metres on one satellite in use for a minute (20 epochs at least), in three trials: the share of
epochs at which exactly it is left out beside what the clean run leaves out, and of those at which
the difference names it with the right signal.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gnss_held_back import EDGE_S, longest_exclusion_s
from gnss_sets import SYSTEMS
from msgspec.structs import replace as with_fields

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.learn_noise import learn_noise
from analysis.recordings.position_reference import read_reference
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.sample import Epoch, Sample
from analysis.scoring.integrity import ERROR, LEVEL, Integrity
from analysis.scoring.position_scores import PositionScores
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.rinex.rinex_text import read_rinex_text

TRIALS = 3
FAULTS = [(kind, size_m) for kind in ("first", "second", "both") for size_m in (10.0, 50.0)]


def planted(
    samples: list[Sample], name: str, kind: str, size_m: float, span_us: Any
) -> list[Sample]:
    """The samples with metres on the first range of a satellite, on the second or on both."""
    out = []
    for sample in samples:
        if isinstance(sample, Epoch) and span_us[0] <= sample.t_us < span_us[1]:
            shift, second = size_m * np.array([s == name for s in sample.satellites]), sample.second
            if kind != "second":
                sample = replace(sample, pseudorange_m=sample.pseudorange_m + shift)
            if kind != "first" and second is not None:
                second = replace(second, pseudorange_m=second.pseudorange_m + shift)
                sample = replace(sample, second=second)
        out.append(sample)
    return out


def decisions(found: list[Result]) -> list[Decision]:
    return [r for r in found if isinstance(r, Decision)]


def named(found: list[Result]) -> dict[int, set[tuple[str, str]]]:
    """The satellites whose two ranges differ, with the reason, by epoch."""
    out: dict[int, set[tuple[str, str]]] = {}
    for r in found:
        if (
            isinstance(r, SensorDecision)
            and r.sensor == "satellites"
            and " off that on " in r.reason
        ):
            out.setdefault(r.t_us, set()).add((r.suspect, r.reason))
    return out


def trials(samples: list[Sample], clean: list[Decision], config: DetectorConfig) -> list[str]:
    """A cell for each fault: epochs with exactly the faulty satellite left out / named, in %."""
    usual = {d.t_us: set(d.excluded) for d in clean if d.position_ecef_m}
    counts: dict[str, int] = {}
    for d in clean:
        for name in set(d.satellites) - set(d.excluded):
            counts[name] = counts.get(name, 0) + 1
    stamps = [s.t_us for s in samples if isinstance(s, Epoch)]
    signals = {
        n: (a, b)
        for s in samples
        if isinstance(s, Epoch) and s.second is not None
        for n, a, b in zip(s.satellites, s.signals, s.second.signals, strict=True)
        if b
    }
    often = sorted(n for n in counts if counts[n] > 0.3 * len(clean) and n in signals)
    step_us = int(np.median(np.diff(stamps)))
    fault_us = max(60_000_000, 20 * step_us)
    cells = []
    for kind, size_m in FAULTS:
        rng, right, total, reported = np.random.default_rng(1), 0, 0, 0
        for _ in range(TRIALS):
            name = str(rng.choice(often))
            own = [d.t_us for d in clean if name in d.satellites and name not in d.excluded]
            room = [t for t in own if own[0] + EDGE_S * 1e6 < t < own[-1] - fault_us]
            if not room:
                continue
            at = int(rng.choice(room))
            cut = [
                s
                for s in samples
                if not isinstance(s, Epoch)
                or at - max(300e6, 60 * step_us) <= s.t_us < at + fault_us
            ]
            found = run_detector(
                Detector(config), planted(cut, name, kind, size_m, (at, at + fault_us))
            )
            texts = named(found)
            for d in decisions(found):
                if at <= d.t_us < at + fault_us and d.t_us in usual:
                    # In view at this epoch.
                    if name not in d.satellites:
                        continue
                    total += 1
                    wanted = {name} if kind != "second" or config.ionosphere_free else set()
                    right += set(d.excluded) == usual[d.t_us] | wanted
                    signal = signals[name][kind == "second"]
                    reported += any(
                        n == name and f"on {signal} is" in t for n, t in texts.get(d.t_us, ())
                    )
        cells.append(f"{100 * right / max(total, 1):.0f} / {100 * reported / max(total, 1):.0f}")
    return cells


def rtklib(
    obs: Path, nav: list[Path], systems: str, dual: bool, stamps: list[int], truth: Any
) -> str:
    """RTKLIB's errors, horizontal and vertical."""
    with tempfile.TemporaryDirectory() as folder:
        plain, options, out = (Path(folder, f"a.{end}") for end in ("obs", "conf", "pos"))
        plain.write_text("\n".join(read_rinex_text(obs)) + "\n")
        navs = []
        for i, path in enumerate(nav):
            navs.append(Path(folder, f"{i}.nav"))
            navs[-1].write_text("\n".join(read_rinex_text(path)) + "\n")
        options.write_text(
            f"pos1-posmode=single\npos1-frequency=l1+l2\npos1-elmask=10\n"
            f"pos1-ionoopt={'dual-freq' if dual else 'brdc'}\npos1-tropopt=saas\n"
            f"pos1-navsys={sum(SYSTEMS[s] for s in systems)}\npos1-posopt5=on\n"
            "out-solformat=xyz\nout-timeform=tow\n"
        )
        subprocess.run(
            ["rnx2rtkp", "-k", options, "-o", out, plain, *navs], check=True, capture_output=True
        )
        found, scores = read_reference(str(out)), PositionScores()
    for place, t_us in zip(found.r_ecef_m, found.t_us.tolist(), strict=True):
        if (at := truth.at(t_us)) is not None:
            scores.add("rtklib", place, None, at)
    return f"{errors(scores.summary()['rtklib'])} ({len(found.t_us)})"


def errors(s: dict[str, Any]) -> str:
    return (
        f"{s['horizontal_50_m']} / {s['horizontal_95_m']}, "
        f"{s['vertical_50_m']} / {s['vertical_95_m']}"
    )


def main(path: Path) -> None:
    head = [
        "recording, systems, ranges",
        "epochs, with a position",
        "error 50 / 95 %: h, v, m",
        "RTKLIB's (epochs)",
        "error over sigma 50 / 95 %",
        "largest error over level h / v",
        "median level h / v",
        "longest exclusion, s",
        "epochs with one",
        "difference alarms",
    ]
    head += [f"{size:.0f} m on {kind}" for kind, size in FAULTS]
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|", flush=True)
    for given in read_document(path).data:
        obs, nav = path.parent / given["obs"], [path.parent / n for n in given["nav"]]
        samples, truth = read_rinex_samples(obs, nav), read_reference(given["truth"])
        stamps = [s.t_us for s in samples if isinstance(s, Epoch)]
        for systems in given["systems"]:
            for dual in (False, True):
                config = DetectorConfig(systems=systems, ionosphere_free=dual)
                learnt = learn_noise(samples, config)
                config = with_fields(config, sigma=learnt.sigma) if learnt else config
                results = run_detector(Detector(config), samples)
                found, texts = decisions(results), named(results)
                scores, integrity = PositionScores(), Integrity(truth)
                integrity.add(found)
                for d in found:
                    at = truth.at(d.t_us)
                    if at is not None and d.position_ecef_m and d.position_sigma_m:
                        scores.add("filter", d.position_ecef_m, d.position_sigma_m, at)
                s = scores.summary()["filter"]
                tables = [integrity.table(way) for way in ("horizontal", "vertical")]
                row = [
                    f"{given['name']}, {systems}, {'two' if dual else 'one'}",
                    f"{len(found)}, {sum(d.position_ecef_m is not None for d in found)}",
                    errors(s),
                    rtklib(obs, nav, systems, dual, stamps, truth),
                    f"{s['over_sigma_50']} / {s['over_sigma_95']}",
                    " / ".join(
                        f"{(t[:, ERROR] / t[:, LEVEL]).max():.2f}" for t in tables if len(t)
                    ),
                    " / ".join(f"{np.median(t[:, LEVEL]):.0f}" for t in tables if len(t)),
                    longest_exclusion_s(found),
                    str(sum(bool(d.excluded) for d in found)),
                    f"{sum(map(len, texts.values()))} in {len(texts)}",
                ]
                print(f"| {' | '.join([*row, *trials(samples, found, config)])} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
