"""`run`: fly a scenario through the proxy, monitor, record and report it."""

import argparse
import contextlib
import math
import time

from analysis.report.curves.fault_effects import deviation_curves
from analysis.report.curves.recording import Signal
from analysis.report.run_folder import make_folder
from analysis.run.flight_session import RECORD_PERIOD_US, FlightSession
from analysis.run.reference_flight import REFERENCE_FOLDER, start_reference_flight
from analysis.run.run_setup import setup_from_args
from analysis.run.stop_signal import stop_requests
from analysis.work_progress import WorkProgress
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from simvehicle.app.battery_warnings import BatteryWarnings
from simvehicle.app.pace import Pace, parse_speed

MAX_PENDING_BATCHES = 10  # two seconds of flight by which the monitor may lag behind a live page
MONITOR_WAIT_S = 0.02  # chosen


def main(args: argparse.Namespace) -> int:
    """Fly, report, and return the verdict's exit code."""
    setup = setup_from_args(args)
    # A live page needs real time; without one, fly as fast as possible.
    pace = Pace(parse_speed(args.speed or ("1" if args.ui else "max")))
    folder = make_folder(args.out, setup.scenario.name)
    args.out = str(folder)  # for the page beside the run
    # Started first, so that both processes compile in parallel.
    reference = start_reference_flight(setup, folder) if args.against_clean else None
    with contextlib.ExitStack() as stack:
        session = FlightSession(args, setup, folder, setup.schedule, stack, zenoh=args.zenoh)
        run_flight(session, pace, open_ground_link(args.gcs, pace), together=args.ui)
        summary = session.summarise()

    def read_curves(t0_us: int, _: object) -> list[Signal] | None:
        # It runs in parallel on the second core, and is usually complete by now.
        if reference is None or not reference.wait_until(session.flight.now_us):
            return None
        return deviation_curves(folder, folder / REFERENCE_FOLDER, t0_us)

    return session.finish(args, summary, read_curves)


def run_flight(session: FlightSession, pace: Pace, ground: Link | None, *, together: bool) -> None:
    """Fly to the end of the scenario or until Ctrl-C, and close the logs.

    With `together`, for a live page, the flight waits for a monitor that falls behind.
    """
    flight, monitor, deliver, recorded_us = session.flight, session.monitor, session.deliver, 0
    with WorkProgress("flying", flight.duration_s) as progress:
        battery = BatteryWarnings(progress.say)
        with stop_requests() as stop:
            # Stop only between two steps, so that logs stay complete.
            while not (flight.finished or stop()):
                # A live page must not show verdicts long after the flight.
                monitor_lags = together and monitor.pending_batches > MAX_PENDING_BATCHES
                wait_s = (
                    MONITOR_WAIT_S if monitor_lags else pace.wait_s(flight.t_us, time.monotonic())
                )
                if wait_s > 0.0:
                    time.sleep(wait_s)
                session.serve()
                if monitor_lags:
                    deliver(monitor.feed(b"", now=True))
                    continue
                sent = flight.advance([data for _, data in ground.read()] if ground else [])
                deliver(monitor.feed(sent.monitor))
                if ground is not None:
                    for data in sent.ground:
                        ground.write(data)
                if flight.t_us - recorded_us >= RECORD_PERIOD_US:
                    recorded_us = flight.t_us
                    battery.update(flight.simulation.truth)
                    session.record()
                    # A live viewer must not wait for a full batch.
                    if together or math.isfinite(pace.speed):
                        deliver(monitor.feed(b"", now=True))
                    active = ", ".join(flight.engine.active) or "no fault"
                    progress.show(flight.t_us * 1e-6, active)
        # A stop ends the faults just as the scenario's end does.
        deliver(monitor.feed(flight.finish().monitor, now=True))
        session.close_logs()


def open_ground_link(spec: str, pace: Pace) -> Link | None:
    """Open the ground station's link; None at full speed, which no ground station can follow."""
    if math.isinf(pace.speed) or spec == "off":
        return None
    return open_link(spec, bare_udp="udpout")
