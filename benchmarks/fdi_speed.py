"""The section of benchmarks/fdi.py on time."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from fdi_static import STATIC_TRUTH_M
from fdi_theory import RNG, covariance, geometry

from analysis.detection import Detector
from analysis.detection.detector_state import DetectorState
from analysis.detection.filter.inertial import propagate_inertial
from analysis.detection.filter.measurement import observe_epoch, predict_innovations
from analysis.detection.isolation.hypotheses import select_hypothesis
from analysis.recordings.read_recordings import read_rinex, read_rinex_samples
from analysis.samples.block import EPOCH, IMU, Block, block_of
from analysis.samples.sample import Epoch, Sample

ROUNDS = 25  # of all epochs, one by one
REPEATS = 7  # the least of so many: what the machine does beside is not the detector's


def least_s(work: Callable[[], object]) -> float:
    """CPU seconds of some work, the least of `REPEATS`."""
    times = []
    for _ in range(REPEATS):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times)


def speed(data: Path) -> None:
    """Time per IMU step and per epoch, and end to end."""
    folder = data / "gnss_imu_walk"
    files = folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    detector = Detector()
    walked = read_rinex(*files)
    detector.step(walked, detector.new_state())  # compile
    read_s = least_s(lambda: read_rinex(*files))
    whole_s = least_s(lambda: detector.step(walked, detector.new_state()))
    x, p = np.zeros(21), np.eye(20)
    x[:3], x[6] = STATIC_TRUTH_M, 1.0
    steps = np.tile(np.r_[0.005, 0.1, 0.0, 0.0, 0.0, 0.0, -9.8], (2000, 1))
    noise = detector.config.noise
    step_us = least_s(lambda: propagate_inertial(x, p, steps, noise)) / len(steps) * 1e6
    static_folder = data / "gnss_static"
    every = read_rinex_samples(static_folder / "SEPT078M.21O", static_folder / "SEPT078M.21P")
    twelve = block_of(with_rates([fewer(s) for s in every]))
    count = len(twelve.rows(EPOCH))
    epoch_us = least_s(lambda: detector.step(twelve, detector.new_state())) / count * 1e6
    design = geometry(12)
    m = np.linalg.inv(covariance(design))
    v = np.full(12, 10.0) * RNG.choice([-1.0, 1.0], 12)
    position, clock = design[:, :3].copy(), design[:, 3:].copy()
    bank_us = (
        least_s(lambda: [select_hypothesis(m, v, position, clock, 1e-4, 2) for _ in range(200)])
        * 5e3
    )
    unit_us = least_s(lambda: [np.linalg.inv(p) for _ in range(500)]) * 2e3
    flight_s = float(np.ptp(walked.t_us[walked.rows(IMU)])) * 1e-6
    print("\n## Speed, CPU time of one core\n\n| what | measured |\n|---|---|")
    print(f"| numpy.linalg.inv of 20 x 20 on this machine, for scale | {unit_us:.0f} us |")
    print(f"| one IMU step, state and covariance | {step_us:.1f} us |")
    print(f"| one epoch of 12 satellites, ranges and rates, all tests | {epoch_us:.0f} us |")
    print(
        f"| the bank, one and two left out, rivals and verdict, 12 satellites | {bank_us:.0f} us |"
    )
    print(f"| an epoch with its bank | {epoch_us + bank_us:.0f} us |")
    print(
        f"| gnss_imu_walk, {flight_s:.0f} s of 152 Hz IMU and 4 Hz GNSS: reading | {read_s:.3f} s |"
    )
    print(f"| the same, detecting | {whole_s:.3f} s |")
    total_s = read_s + whole_s
    print(f"| both | {total_s:.3f} s, {flight_s / total_s:.0f} times real time |")
    single_epochs([fewer(s) for s in every])


def single_epochs(samples: list[Sample]) -> None:
    """Each epoch by itself, with protection levels and lasting errors as always, from the state
    that the recording led to: as it is, and with 50 m on one satellite, which asks the bank."""
    print("\n| one epoch of 12 satellites, us | median | 99 % | most |\n|---|---|---|---|")
    detector, state = Detector(), Detector().new_state()
    jobs: dict[str, list[tuple[Block, DetectorState]]] = {
        "no test trips": [],
        "with its bank and verdict": [],
    }
    for sample in with_rates(samples):
        if isinstance(sample, Epoch):
            place = len(jobs["no test trips"]) % len(sample.satellites)
            step_m = 50.0 * (np.arange(len(sample.satellites)) == place)
            wrong = replace(sample, pseudorange_m=sample.pseudorange_m + step_m)
            for title, given in zip(jobs, (sample, wrong), strict=True):
                jobs[title].append((block_of([given]), state))
        _, state = detector.step(sample, state)
    for title, work in jobs.items():
        times = np.full(len(work), np.inf)
        # In rounds, not one epoch often: what else the machine does lasts for seconds.
        for _ in range(ROUNDS):
            for i, (block, before) in enumerate(work):
                began = time.process_time()
                detector.step(block, before)
                times[i] = min(times[i], time.process_time() - began)
        late = times[60:] * 1e6  # the first minute finds its feet
        median, most = np.percentile(late, [50, 99])
        print(f"| {title} | {median:.0f} | {most:.0f} | {late.max():.0f} |")


def with_rates(samples: list[Sample]) -> list[Sample]:
    """The samples with Doppler rates, which the recording has none of, as the filter has them."""
    detector = Detector()
    state, rng, out = detector.new_state(), np.random.default_rng(3), []
    for s in samples:
        state = detector.step(s, state)[1]
        if isinstance(s, Epoch):
            core = state.core
            still = replace(s, doppler_mps=np.zeros(len(s.satellites)))
            observed = observe_epoch(still, core.broadcast.selection)
            seen = predict_innovations(
                observed, core.motion.x, detector.config.sigma, core.broadcast.ionosphere
            )
            noise = np.sqrt(seen.rate_variance) * rng.standard_normal(len(s.satellites))
            s = replace(s, doppler_mps=noise - seen.rate_mps)
        out.append(s)
    return out


def fewer(sample: Sample) -> Sample:
    """An epoch with its first twelve GPS and Galileo satellites of those always there."""
    if not isinstance(sample, Epoch):
        return sample
    names = ["E03", "E08", "E13", "E15", "E21", "G01", "G03", "G04", "G06", "G09", "G17", "G19"]
    return sample.select([i for i, name in enumerate(sample.satellites) if name in names])
