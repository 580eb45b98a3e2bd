"""Fly a cell in the simulator, through the proxy, with the monitor and the estimators under test.

The simulator's controller uses the truth, so the flight does not depend on the subject, and all
subjects share it.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.flying.flight_evidence import (
    MONITOR,
    POSITION,
    CampaignFlight,
    Evidence,
    EvidenceCurve,
    attitude_curve,
    monitor_verdict,
    seconds_since,
)
from analysis.flying.flight_phases import PhaseTracker
from analysis.monitor.monitor import Monitor
from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.flight_signals import judge_requirements
from analysis.report.recordings.from_tlog import recording_of_tlog
from analysis.report.run_folder import ResultFile
from analysis.results import Decision, Result, SensorDecision
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.reference_flight import BATCH_BYTES
from analysis.run.run_setup import RunSetup
from analysis.scoring.criteria import Criteria
from analysis.scoring.requirements import RequirementResult
from analysis.scoring.vehicle_outcome import VehicleEvent
from mavproxy_fault.app.recorder import SENT, Recorder
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.tlog import read_columns
from simvehicle.vehicles.body import Truth

TRACK_US = 100_000
Vector = NDArray[np.float64]


def run_simulated_flight(
    setup: RunSetup,
    subjects: Sequence[str],
    keep: Path | None = None,
    stop: Callable[[Truth], bool] | None = None,
) -> CampaignFlight:
    """Fly a scenario to its end, or until a truth makes it `stop`, and collect the evidence by
    subject; `keep` is the folder for the logs."""
    started_s = time.monotonic()
    flight, monitor = ProxiedFlight(setup.scenario, setup.schedule), Monitor(setup.monitor)
    phases, results = PhaseTracker(), list[Result]()
    track: list[tuple[float, ...]] = []
    next_us, batch = 0, bytearray()
    while not flight.finished:
        batch += flight.advance([]).monitor
        if stop is not None and stop(flight.simulation.truth):
            break
        if flight.t_us >= next_us:
            next_us = flight.t_us + TRACK_US
            if len(batch) >= BATCH_BYTES:
                results += monitor.push_bytes([bytes(batch)], datagrams=False)
                batch.clear()
            truth = flight.simulation.truth
            position_ecef_m = ecef_from_geodetic(truth.lat_rad, truth.lon_rad, truth.height_m)
            track.append((flight.vehicle_us, *position_ecef_m))
            phases.track(flight.t_us * 1e-6, truth)
    batch += flight.finish().monitor
    results += monitor.push_bytes([bytes(batch)], datagrams=False)
    t0_us = flight.core.clock.t0_us or 0
    evidence = {
        name: monitor_evidence(results, np.array(track), t0_us)
        if name == MONITOR
        else Evidence({}, alarm_marks(monitor.alarms[name], t0_us))
        if name in monitor.alarms
        else Evidence(attitude_curve(results, (name,), t0_us))
        for name in subjects
    }
    labels = flight.drain_labels()
    with tempfile.TemporaryDirectory(prefix="campaign-") as scratch:
        folder = Path(scratch) if keep is None else keep
        if keep is not None or setup.requirements:
            write_logs(flight, labels, results, folder)
        completed = flight.completed_labels()
        judged = {name: judge_flight(setup, folder, completed, results, name) for name in subjects}
    summary = monitor.summary(completed, Criteria(), 0.0)
    begun_us = min((label.start_us for label in completed), default=None)
    return CampaignFlight(
        evidence, phases.begin_s, flight.t_us * 1e-6, time.monotonic() - started_s,
        attitude=summary["attitude"], verdict=monitor_verdict(summary["faults"]),
        requirements=judged,
        fault_s=None if begun_us is None else round((begun_us - t0_us) * 1e-6, 3),
    )  # fmt: skip


def judge_flight(
    setup: RunSetup, folder: Path, labels: Sequence[Label], results: Sequence[Result], subject: str
) -> list[RequirementResult]:
    """Judge the requirements by the logs of a flight, with the errors of a subject."""
    if not setup.requirements:
        return []
    t0_us = labels[0].t0_us if labels else None
    columns = read_columns(folder / SENT)
    recording = add_derived_curves(recording_of_tlog(columns, t0_us=t0_us))
    return judge_requirements(
        setup.requirements, recording, labels, results, setup.scenario.start.alt_m, subject
    )


def write_logs(
    flight: ProxiedFlight, labels: Sequence[Label], results: Sequence[Result], folder: Path
) -> None:
    """Write the flight's tlogs, labels and results, as `run` does."""
    links = [{"name": role.name, "direction": role.direction} for role in flight.core.links]
    recorder = Recorder(folder, {"schedule": flight.engine.save(), "links": links})
    recorder.write(flight.capture, labels)
    with ResultFile(folder) as file:
        file.write(results)
    recorder.close(flight.core.clock.t0_us, flight.now_us)


def alarm_marks(results: Sequence[Result], t0_us: int) -> list[VehicleEvent]:
    """The alarms among the results of detectors, by seconds from `t0_us`."""
    return [
        VehicleEvent(seconds_since(r, t0_us), "detected", r.sensor)
        for r in results
        if isinstance(r, SensorDecision) and r.alarm
    ]


def monitor_evidence(results: Sequence[Result], track: Vector, t0_us: int) -> Evidence:
    """Return the monitor's position error and alarms; `track` (n, 4) is the truth [us, m ECEF]."""
    decisions = [r for r in results if isinstance(r, Decision)]
    fixes = [d for d in decisions if d.position_ecef_m is not None]
    curves = {}
    if fixes:
        t_us = np.array([d.t_us for d in fixes])
        true = np.stack([np.interp(t_us, track[:, 0], track[:, i]) for i in (1, 2, 3)], axis=1)
        error = np.linalg.norm(np.array([d.position_ecef_m for d in fixes]) - true, axis=1)
        curves[POSITION] = EvidenceCurve(
            [seconds_since(d, t0_us) for d in fixes], error.round(3).tolist()
        )
    alarms = [
        VehicleEvent(seconds_since(d, t0_us), "detected", d.hypothesis)
        for d in decisions
        if d.alarm
    ]
    alarms += alarm_marks(results, t0_us)
    return Evidence(curves, sorted(alarms, key=lambda mark: mark.t_s))
