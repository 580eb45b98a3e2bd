"""The section of benchmarks/fdi.py on time."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from fdi_static import STATIC_TRUTH_M
from fdi_theory import RNG, covariance, geometry

from analysis.fdi import Detector, DetectorConfig
from analysis.fdi.detector import run
from analysis.fdi.inertial import propagate_inertial
from analysis.fdi.measure import model, observe
from analysis.fdi.verdict import judge
from analysis.recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples import Epoch, ImuSample, Sample


def speed(data: Path) -> None:
    """Time per IMU step and per epoch, and end to end."""
    folder = data / "gnss_imu_walk"
    files = folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    run(Detector(), read_rinex_samples(*files)[:6000])  # compile
    began = time.process_time()
    samples = read_rinex_samples(*files)
    read_s = time.process_time() - began
    began = time.process_time()
    run(Detector(), samples)
    whole_s = time.process_time() - began
    imu = [s for s in samples if isinstance(s, ImuSample)]
    x, p = np.zeros(21), np.eye(20)
    x[:3], x[6] = STATIC_TRUTH_M, 1.0
    block = np.tile(np.r_[0.005, 0.1, 0.0, 0.0, 0.0, 0.0, -9.8], (2000, 1))
    noise = DetectorConfig().noise.densities
    propagate_inertial(x, p, block, noise)
    began = time.process_time()
    propagate_inertial(x, p, block, noise)
    step_us = (time.process_time() - began) / len(block) * 1e6
    static_folder = data / "gnss_static"
    every = read_rinex_samples(static_folder / "SEPT078M.21O", static_folder / "SEPT078M.21P")
    twelve = with_rates([fewer(s) for s in every])
    run(Detector(), twelve[:300])
    began = time.process_time()
    count = sum(isinstance(r, Decision) for r in run(Detector(), twelve))
    epoch_us = (time.process_time() - began) / count * 1e6
    design = geometry(12)
    m = np.linalg.inv(covariance(design))
    v = np.full(12, 10.0) * RNG.choice([-1.0, 1.0], 12)
    judge(m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, 2)
    began = time.process_time()
    for _ in range(500):
        judge(m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, 2)
    bank_us = (time.process_time() - began) / 500 * 1e6
    a = np.eye(20) + 0.1
    began = time.process_time()
    for _ in range(2000):
        np.linalg.inv(a)
    unit_us = (time.process_time() - began) / 2000 * 1e6
    flight_s = (imu[-1].t_us - imu[0].t_us) * 1e-6
    print("\n## Speed, CPU time of one core\n\n| what | measured |\n|---|---|")
    print(f"| numpy.linalg.inv of 18 x 18 on this machine, for scale | {unit_us:.0f} us |")
    print(f"| one IMU step, state and covariance | {step_us:.1f} us |")
    print(f"| one epoch of 12 satellites, ranges and rates, all tests | {epoch_us:.0f} us |")
    print(
        f"| the bank, one and two left out, rivals and verdict, 12 satellites | {bank_us:.0f} us |"
    )
    print(
        f"| gnss_imu_walk, {flight_s:.0f} s of 152 Hz IMU and 4 Hz GNSS: reading | {read_s:.2f} s |"
    )
    print(f"| the same, detecting | {whole_s:.2f} s, {flight_s / whole_s:.0f} times real time |")


def with_rates(samples: list[Sample]) -> list[Sample]:
    """The samples with Doppler rates, which the recording has none of, as the filter has them."""
    detector = Detector()
    state, rng, out = detector.new_state(), np.random.default_rng(3), []
    for s in samples:
        state = detector.step(s, state)[1]
        if isinstance(s, Epoch):
            core = state.core
            still = replace(s, doppler_mps=np.zeros(len(s.satellites)))
            observed = observe(still, core.chosen)
            seen = model(observed, core.motion.x, detector.config.sigma, core.ionosphere)
            noise = np.sqrt(seen.rate_variance) * rng.standard_normal(len(s.satellites))
            s = replace(s, doppler_mps=noise - seen.v_mps)
        out.append(s)
    return out


def fewer(sample: Sample) -> Sample:
    """An epoch with its first twelve GPS and Galileo satellites of those always there."""
    if not isinstance(sample, Epoch):
        return sample
    names = ["E03", "E08", "E13", "E15", "E21", "G01", "G03", "G04", "G06", "G09", "G17", "G19"]
    return sample.select([i for i, name in enumerate(sample.satellites) if name in names])
