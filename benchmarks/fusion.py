"""What the fused position is worth: after isolation, without it, with GTSAM's robust losses.

Run by hand: `python benchmarks/fusion.py flight DIR` on the folder of a `mavproxy-fault run` (its
received.tlog is the flight without faults, its sent.tlog the one with them), `... walk DATA` on the
folder gnss_imu_walk (needs RTKLIB's rnx2rtkp), or `... time`, `... nees [FLIGHTS]`,
`... seeds [FIRST [LAST]]`, `... memory [SECONDS [EVERY]]` on simulated flights of its own.
"""

import math
import platform
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import chi2

from analysis.detection import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.sensors.sensor_models import density_kgpm3
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.local_frame import frame_at
from analysis.fusion.smoother import Fusion
from analysis.monitor.pipeline import Pipeline, monitor_config
from analysis.recordings.read_recordings import read_log, read_rinex_samples
from analysis.results import Decision, FusedState, Result
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import read_setup
from analysis.samples.block import TRUTH, Block, block_of, split_at_events
from analysis.samples.decoder import Decoder
from analysis.samples.sample import (
    AirspeedSample,
    BaroSample,
    Epoch,
    ImuSample,
    MagSample,
    Sample,
    TruthSample,
    Vector,
)
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.gnss.constellation import build_constellation
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.gnss_sensor import GnssSensor

sys.path.append(str(Path(__file__).parents[1] / "tests" / "analysis"))
import conftest  # the tests' flight

Row = tuple[Sample, list[Result], DetectorCore]
Truths = dict[int, tuple[float, float, float]]
SETTINGS = {
    "isolated (default)": FusionConfig(),
    "no decisions": FusionConfig(decide=False),
    "no decisions, Huber": FusionConfig(decide=False, robust="huber"),
    "no decisions, Geman-McClure": FusionConfig(decide=False, robust="geman-mcclure"),
    "no decisions, GNC": FusionConfig(decide=False, robust="gnc"),
}
DEFAULT = DetectorConfig()
NOISES = {"learned (default)": FusionConfig(), "as configured": FusionConfig(learn=False)}
WALK_GEOID_M = 21.387  # of the folder's README: heights of the reference are above sea level
STEP_M, STEP_FROM_S, STEP_FOR_S = 50.0, 60.0, 30.0
TIMED_S, TIMED_RUNS = 40.0, 4
NEES_S, SEED_S = 40.0, 60.0
FIRST_SEED = 1000  # flights that nothing was set on
PERIOD_S = 40.0  # of the tests' flight
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


def detected(samples: Iterable[Sample], detector: DetectorConfig = DEFAULT) -> list[Row]:
    """Every sample with what the detector said, so that settings share its work."""
    references = NavigationDetector(detector)
    state = references.new_state()
    rows = []
    for sample in samples:
        results, state = references.step(sample, state)
        rows.append((sample, results, state.detector.core))
    return rows


def fused(
    rows: list[Row], config: FusionConfig, detector: DetectorConfig = DEFAULT
) -> list[FusedState]:
    """The fused states under one setting."""
    fusion = Fusion(config, detector)
    state = fusion.new_state()
    found: list[FusedState] = []
    for sample, results, core in rows:
        (piece,) = split_at_events(sample)
        said, state = fusion.step(piece, results, core, state)
        found += [r for r in said if isinstance(r, FusedState)]
    return found


def errors(states: Iterable[FusedState | Decision], truths: Truths) -> dict[int, Vector]:
    """Position error (3,) north, east, down by time."""
    found = {}
    for state in states:
        truth = truths.get(state.t_us)
        if truth is not None and state.position_ecef_m is not None:
            axes = ned_axes(truth[0], truth[1])
            found[state.t_us] = axes @ (
                np.array(state.position_ecef_m) - np.asarray(ecef_from_geodetic(*truth))
            )
    return found


def rmse(found: dict[int, Vector], skip_s: float = 10.0) -> float:
    """Root mean square of the error's length without the first seconds, in metres."""
    if not found:
        return math.nan
    first = min(found) + skip_s * 1e6
    return math.sqrt(float(np.mean([e @ e for t, e in found.items() if t >= first])))


def spread(found: dict[int, Vector], skip_s: float = 10.0) -> float:
    """The same about the mean error: what a constant offset, of the reference too, leaves."""
    first = min(found) + skip_s * 1e6
    late = np.array([e for t, e in found.items() if t >= first])
    return rmse({k: e for k, e in enumerate(late - late.mean(axis=0))}, 0.0)


def nees(states: list[FusedState], found: dict[int, Vector]) -> float:
    """Mean normalised squared position error; 3 where the sigmas are right."""
    each = [
        float(((found[s.t_us] / s.position_sigma_m) ** 2).sum()) for s in states if s.t_us in found
    ]
    return float(np.mean(each[len(each) // 8 :])) if each else math.nan


def decisions(rows: list[Row]) -> list[Decision]:
    """The detector's decisions."""
    return [r for _, results, _ in rows for r in results if isinstance(r, Decision)]


def tlog_samples(path: Path) -> list[Sample]:
    """The samples of a recording."""
    return [sample for block in read_log(path) for sample in block.samples()]


def flight(folder: Path) -> None:
    """The table of a simulated flight."""
    clean_samples = tlog_samples(folder / "received.tlog")
    truths = {
        s.t_us: (math.radians(s.lat_deg), math.radians(s.lon_deg), s.alt_m)
        for s in clean_samples
        if isinstance(s, TruthSample)
    }
    clean = detected(clean_samples)
    states = fused(clean, FusionConfig())
    found = errors(states, truths)
    best = rmse(found)
    print("| flight | position RMSE m | against fault-free | NEES (3) |\n|---|---|---|---|")
    print(f"| fault-free, fused | {best:.2f} | 1.00 | {nees(states, found):.2f} |")
    print(
        f"| fault-free, the detector's filter | {rmse(errors(decisions(clean), truths)):.2f} | | |"
    )
    faulty = detected(tlog_samples(folder / "sent.tlog"))
    for name, config in SETTINGS.items():
        states = fused(faulty, config)
        found = errors(states, truths)
        value = rmse(found)
        print(f"| faults, {name} | {value:.2f} | {value / best:.2f} | {nees(states, found):.1f} |")
    print(f"| faults, the detector's filter | {rmse(errors(decisions(faulty), truths)):.2f} | | |")


def gps_us(day: str, clock: str) -> int:
    """Microseconds since the start of GPS time, of a date and time in it."""
    stamp = datetime.strptime(f"{day} {clock}", "%Y/%m/%d %H:%M:%S.%f")
    since = stamp.replace(tzinfo=UTC) - GPS_EPOCH
    return round(since.total_seconds() * 1e6)


def positions(text: str, geoid_m: float) -> Truths:
    """RTKLIB's position file: latitude and longitude in rad, ellipsoidal height, by time."""
    found = {}
    for line in text.splitlines():
        if line and not line.startswith("%"):
            day, clock, lat, lon, height = line.split()[:5]
            found[gps_us(day, clock)] = (
                math.radians(float(lat)),
                math.radians(float(lon)),
                float(height) - geoid_m,
            )
    return found


def nearest(truths: Truths, stamps: Iterable[int]) -> Truths:
    """The reference at the nearest of its times, within 20 ms (a walk of 3 cm)."""
    known = np.array(sorted(truths))
    found = {}
    for t_us in stamps:
        best = int(known[np.argmin(np.abs(known - t_us))])
        if abs(best - t_us) <= 20_000:
            found[t_us] = truths[best]
    return found


def walk(folder: Path) -> None:
    """The table of the walk with a receiver and an IMU in hand."""
    observations, navigation = folder / "walk_ex.obs", folder / "walk_ex.nav"
    truths = positions((folder / "gnss_1730_sf.pos").read_text(), WALK_GEOID_M)
    command = ["rnx2rtkp", "-p", "0", "-m", "10", "-sys", "G,E", "-t", observations, navigation]
    single = positions(
        subprocess.run(command, check=True, capture_output=True, text=True).stdout, 0.0
    )
    near = nearest(truths, single)
    found = {
        t_us: ned_axes(*near[t_us][:2])
        @ (np.asarray(ecef_from_geodetic(*at)) - np.asarray(ecef_from_geodetic(*near[t_us])))
        for t_us, at in single.items()
        if t_us in near
    }
    print(
        "| walk | position RMSE m | about its mean m | mean north, east, down m "
        "| NEES (3) | about its mean |"
    )
    print("|---|---|---|---|---|---|")
    print(row("RTKLIB, single point", found))
    samples = read_rinex_samples(observations, navigation, folder / "imu_1730_sf.csv")
    epochs = [s for s in samples if isinstance(s, Epoch)]
    truths = nearest(truths, [s.t_us for s in epochs])
    start_us = epochs[0].t_us
    rows = detected(samples)
    wrong = common(epochs)
    for title, these in (
        ("clean", rows),
        (
            f"{STEP_M:.0f} m on {wrong} for {STEP_FOR_S:.0f} s",
            detected(stepped(samples, wrong, start_us)),
        ),
    ):
        value = errors(decisions(these), truths)
        print(row(f"{title}: the detector's filter", value))
        for name, config in list(SETTINGS.items())[: 1 if title == "clean" else None]:
            states = fused(these, config)
            value = errors(states, truths)
            middle = np.mean(list(value.values()), axis=0)
            about = {t_us: error - middle for t_us, error in value.items()}
            squares = f"{nees(states, value):.1f} | {nees(states, about):.1f}"
            print(row(f"{title}: {name}", value, squares), flush=True)


def row(title: str, found: dict[int, Vector], squares: str = " | ") -> str:
    """A row of the walk's table."""
    mean = ", ".join(f"{value:.1f}" for value in np.mean(list(found.values()), axis=0))
    return f"| {title} | {rmse(found):.2f} | {spread(found):.2f} | {mean} | {squares} |"


def common(epochs: list[Epoch]) -> str:
    """The GPS satellite with the best signal over all epochs."""
    sums: dict[str, float] = {}
    for epoch in epochs:
        for name, cn0 in zip(epoch.satellites, epoch.cn0_dbhz, strict=True):
            if name[0] == "G" and np.isfinite(cn0):
                sums[name] = sums.get(name, 0.0) + float(cn0)
    return max(sums, key=lambda name: sums[name])


def stepped(samples: list[Sample], name: str, start_us: int) -> list[Sample]:
    """The samples with one satellite's pseudorange wrong for a while."""
    first = start_us + round(STEP_FROM_S * 1e6)
    last = first + round(STEP_FOR_S * 1e6)
    return [
        replace(
            s,
            pseudorange_m=s.pseudorange_m + STEP_M * np.array([n == name for n in s.satellites]),
        )
        if isinstance(s, Epoch) and first <= s.t_us < last
        else s
        for s in samples
    ]


def flight_of(seconds: float, seed: int = 1, satellites: int | None = None) -> list[Sample]:
    """A clean simulated flight of the tests (200 Hz IMU, 5 Hz), with that many satellites."""
    samples = conftest.make_flight(seconds, seed)
    return samples if satellites is None else [fewer(s, satellites) for s in samples]


def fewer(sample: Sample, satellites: int) -> Sample:
    """An epoch with the first few of its satellites."""
    if not isinstance(sample, Epoch):
        return sample
    keep = slice(0, satellites)
    return replace(
        sample,
        satellites=sample.satellites[keep],
        pseudorange_m=sample.pseudorange_m[keep],
        doppler_mps=sample.doppler_mps[keep],
        cn0_dbhz=sample.cn0_dbhz[keep],
    )


def timing() -> None:
    """Milliseconds of processor time per GNSS epoch with all samples since the last one.

    Of the fastest of several runs: what else the machine does only makes them slower.
    """
    samples = flight_of(TIMED_S, satellites=10)
    print("| 10 satellites, 5 Hz, 200 Hz IMU, 5 s lag | median ms | mean ms | 95 % ms |")
    print("|---|---|---|---|")
    for title, these in (
        ("IMU, pseudoranges, Doppler", samples),
        ("and barometer, magnetometer, airspeed at 10 Hz", with_others(samples)),
    ):
        runs = [timed(these) for _ in range(TIMED_RUNS)]
        detector, fusion = min(runs, key=lambda spent: float(spent[1].mean()))
        for what, spent in (
            ("fusion", fusion),
            ("the detector before it", detector),
            ("both", detector + fusion),
        ):
            print(
                f"| {title}: {what} | {np.median(spent):.2f} | {spent.mean():.2f} "
                f"| {np.percentile(spent, 95):.2f} |"
            )
    print(f"\n{platform.processor() or platform.machine()}, Python {platform.python_version()}")


def timed(samples: list[Sample]) -> tuple[Vector, Vector]:
    """Milliseconds (n,) per epoch of the detector and of the fusion, without the first quarter.

    As the pipeline does it, with a block of samples per epoch.
    """
    references, fusion = NavigationDetector(DetectorConfig()), Fusion()
    detector_state, state = references.new_state(), fusion.new_state()
    spent: list[tuple[float, float]] = []
    for block in blocks(samples):
        detecting = fusing = 0.0
        said: list[Result] = []
        start = time.process_time()
        for piece in split_at_events(block):
            results, detector_state = references.step_piece(piece, detector_state)
            middle = time.process_time()
            found, state = fusion.step(piece, results, detector_state.detector.core, state)
            said += found
            detecting, start = detecting + middle - start, time.process_time()
            fusing += start - middle
        if said:
            spent.append((detecting, fusing))
    rest = np.array(spent[len(spent) // 4 :]) * 1e3
    return rest[:, 0], rest[:, 1]


def blocks(samples: Iterable[Sample]) -> Iterable[Block]:
    """The samples up to each epoch."""
    gathered: list[Sample] = []
    for sample in samples:
        gathered.append(sample)
        if isinstance(sample, Epoch):
            yield block_of(gathered)
            gathered = []


def with_others(samples: list[Sample]) -> list[Sample]:
    """The flight with a healthy barometer, magnetometer and airspeed at 10 Hz near the truth."""
    rng = np.random.default_rng(5)
    first = next(s for s in samples if isinstance(s, TruthSample))
    lat, lon = math.radians(first.lat_deg), math.radians(first.lon_deg)
    field_ned = (
        np.array([1.0, 1.0, -1.0])
        * (
            frame_at(np.asarray(ecef_from_geodetic(lat, lon, first.alt_m)), first.t_us).field_gauss[
                [1, 0, 2]
            ]
        )
    )
    found: list[Sample] = []
    truth = first
    for sample in samples:
        found.append(sample)
        if isinstance(sample, TruthSample):
            truth = sample
        if not isinstance(sample, ImuSample) or sample.t_us % 100_000 or not sample.t_us:
            continue
        t_us, late_s = sample.t_us, (sample.t_us - truth.t_us) * 1e-6
        height = truth.alt_m - truth.v_ned_mps[2] * late_s
        pressure = pressure_pa(height) + rng.normal(0.0, 3.0)
        body = matrix_from_quat(truth.q_nb).T @ field_ned
        speed = float(np.linalg.norm(truth.v_ned_mps))
        found.append(BaroSample(t_us, pressure, height))
        found.append(MagSample(t_us, body + rng.normal(0.0, 0.01, 3)))
        found.append(AirspeedSample(t_us, 0.5 * density_kgpm3(height) * speed**2))
    return found


def pressure_pa(height_m: float) -> float:
    """Of the standard atmosphere (ISO 2533)."""
    return float(101_325.0 * (1.0 - 2.25577e-5 * height_m) ** 5.25588)


def demo_flight(seed: int) -> tuple[list[Sample], DetectorConfig]:
    """The demo scenario's flight without faults, and the input of its monitor."""
    setup = read_setup(None, None, seed)
    flown = ProxiedFlight(msgspec.structs.replace(setup.scenario, duration_s=NEES_S), Schedule())
    parser, decoder = Parser(), Decoder()
    samples: list[Sample] = []
    while not flown.finished:
        items = parser.push(flown.advance([]).monitor)
        samples += decoder.decode(i for i in items if isinstance(i, Frame)).samples()
    return samples, setup.monitor.detector


def honesty(flights: int = 16) -> None:
    """Normalised squared errors at the end of independent clean flights, one epoch of each."""
    band = chi2.ppf([0.025, 0.975], 3 * flights) / flights
    print(f"{flights} flights of {NEES_S:.0f} s, 95 % band {band[0]:.2f} to {band[1]:.2f}\n")
    print("| flight, noise | position (3) | velocity (3) | attitude (3) |\n|---|---|---|---|")
    found: dict[str, list[tuple[float, float, float]]] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + flights):
        for name, (samples, detector) in (
            ("demo", demo_flight(seed)),
            ("the tests'", (flight_of(NEES_S, seed), DEFAULT)),
        ):
            rows = detected(samples, detector)
            truths = {s.t_us: s for s in samples if isinstance(s, TruthSample)}
            for title, config in NOISES.items():
                states = fused(rows, config, detector)
                state = next(s for s in reversed(states) if s.t_us in truths)
                squares = normalised_squares(state, truths[state.t_us])
                found.setdefault(f"{name}, {title}", []).append(squares)
    for title, each in found.items():
        cells = " | ".join(f"{value:.2f}" for value in np.mean(each, axis=0))
        print(f"| {title} | {cells} |", flush=True)


def normalised_squares(state: FusedState, truth: TruthSample) -> tuple[float, float, float]:
    """Squared errors of position, velocity and attitude over their reported variances."""
    lat, lon = math.radians(truth.lat_deg), math.radians(truth.lon_deg)
    true_m = np.asarray(ecef_from_geodetic(lat, lon, truth.alt_m))
    off_m = ned_axes(lat, lon) @ (np.array(state.position_ecef_m) - true_m)
    off_mps = np.array(state.velocity_ned_mps) - truth.v_ned_mps
    turn = matrix_from_quat(truth.q_nb).T @ matrix_from_quat(np.array(state.q_nb))
    off_rad = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    parts = (
        (off_m, state.position_sigma_m),
        (off_mps, state.velocity_sigma_mps),
        (np.degrees(off_rad), state.attitude_sigma_deg),
    )
    found = [float(((off / np.array(sigma)) ** 2).sum()) for off, sigma in parts]
    return found[0], found[1], found[2]


def seeds(first: int = 31, last: int = 42) -> None:
    """Fused error over the filter's of single flights: clean, with faults, and the demo's."""
    print("| seed | tests' flight, clean: filter m, ratio | with faults | demo, clean |")
    print("|---|---|---|---|")
    for seed in range(first, last + 1):
        samples = flight_of(SEED_S, seed)
        flights = [(samples, DEFAULT), (faulted(samples, seed), DEFAULT), demo_flight(seed)]
        cells = []
        for flown, detector in flights:
            truths = {
                s.t_us: (math.radians(s.lat_deg), math.radians(s.lon_deg), s.alt_m)
                for s in flown
                if isinstance(s, TruthSample)
            }
            rows = detected(flown, detector)
            found = errors(fused(rows, FusionConfig(), detector), truths)
            both = {t: e for t, e in errors(decisions(rows), truths).items() if t in found}
            own = rmse({t: found[t] for t in both})
            cells.append(f"{rmse(both):.2f}, {own / rmse(both):.2f}")
        print(f"| {seed} | {' | '.join(cells)} |", flush=True)


def faulted(samples: list[Sample], seed: int) -> list[Sample]:
    """A flight with three faults of ten seconds: of a step, a ramp and two steps on its satellites
    and one on a gyro, in an order and of sizes by chance."""
    rng = np.random.default_rng(seed)
    names = sorted({n for s in samples if isinstance(s, Epoch) for n in s.satellites})
    kinds = rng.permutation(["step", "ramp", "two", "gyro"])[:3].tolist()
    found: list[Sample] = []
    plans = [
        (kind, at_s, rng.choice(names, 2 if kind == "two" else 1, replace=False), size_m)
        for kind, at_s, size_m in zip(kinds, (15.0, 29.0, 43.0), (50.0, -30.0, 20.0), strict=True)
    ]
    for sample in samples:
        for kind, at_s, faulty, size_m in plans:
            since_s = sample.t_us * 1e-6 - at_s
            if not 0.0 <= since_s < 10.0:
                continue
            if kind == "gyro" and isinstance(sample, ImuSample):
                sample = replace(sample, gyro_b_rps=sample.gyro_b_rps + np.array([0.2, 0.0, 0.0]))
            elif kind != "gyro" and isinstance(sample, Epoch):
                change_m = size_m if kind != "ramp" else since_s
                wrong = np.isin(sample.satellites, faulty)
                sample = replace(sample, pseudorange_m=sample.pseudorange_m + change_m * wrong)
        found.append(sample)
    return found


def hour(seconds: float, every: int) -> Iterable[Sample]:
    """A flight of any length with ten satellites, without keeping it: the eight takes 40 s.

    Of the IMU's samples (200 Hz) and the epochs (5 Hz) one of so many.
    """
    period = [s for s in conftest.make_flight(PERIOD_S) if s.t_us < PERIOD_S * 1e6]
    imu = [s for s in period if isinstance(s, ImuSample)][::every]
    once = sorted(
        [*imu, *[s for s in period if isinstance(s, TruthSample)][::every]], key=lambda s: s.t_us
    )
    rng = np.random.default_rng(3)
    gnss = GnssSensor(GnssConfig(), build_constellation(GnssConfig(), conftest.LAT, conftest.LON))
    state = gnss.new_state(rng)
    for turn in range(round(seconds / PERIOD_S)):
        shift_us = round(turn * PERIOD_S * 1e6)
        for sample in once:
            if isinstance(sample, TruthSample):
                here = math.radians(sample.lat_deg), math.radians(sample.lon_deg), sample.alt_m
                t_us = sample.t_us + shift_us
                rot = matrix_from_quat(sample.q_nb)
                truth = conftest._truth(t_us, *here, sample.v_ned_mps, rot)
                readings, state = gnss.sample(truth, state, rng)
                for reading in readings:
                    for each in conftest._samples(reading, False):
                        yield fewer(each, 10)
            yield replace(sample, t_us=sample.t_us + shift_us)


def memory(seconds: int = 3601, every: int = 1) -> None:
    """Resident memory over a long flight through the pipeline, faster than real time."""
    pipeline = Pipeline(monitor_config({"fusion": {}, "attitude": {"estimators": []}}, "memory"))
    mark_s, epochs, start = 0.0, 0, time.perf_counter()
    errors_m: list[float] = []
    last: FusedState | None = None
    print("| flown, min | resident MB | epochs | position RMSE m |\n|---|---|---|---|")
    for block in blocks(hour(seconds, every)):
        said = [r for r in pipeline.push(block) if isinstance(r, FusedState)]
        epochs += len(said)
        for row in block.rows(TRUTH):  # that of an epoch comes after it
            if last is not None and last.t_us == block.t_us[row]:
                lat_deg, lon_deg, alt_m = block.values[row, 7:10]
                true_m = ecef_from_geodetic(math.radians(lat_deg), math.radians(lon_deg), alt_m)
                errors_m.append(math.dist(true_m, last.position_ecef_m))
        last = said[-1] if said else last
        if block.t_us[-1] * 1e-6 >= mark_s + 300.0:
            mark_s += 300.0
            resident_mb = int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
            value = math.sqrt(float(np.mean(np.square(errors_m))))
            print(f"| {mark_s / 60:.0f} | {resident_mb:.1f} | {epochs} | {value:.2f} |", flush=True)
    print(f"\n{seconds / (time.perf_counter() - start):.1f} times real time")


if __name__ == "__main__":
    section, given = sys.argv[1], sys.argv[2:]
    if section in ("flight", "walk"):
        {"flight": flight, "walk": walk}[section](Path(given[0]))
    else:
        {"time": timing, "nees": honesty, "seeds": seeds, "memory": memory}[section](
            *(int(n) for n in given)
        )
