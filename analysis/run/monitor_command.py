"""`monitor`: fault detection, fusion and scores on a live link, a log, or RINEX files."""

import argparse
import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from analysis.detection.filter.range_noise import SigmaModel
from analysis.detection.recorded_sky import RecordedSky
from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.monitor.publish import Publisher
from analysis.monitor.terminal_status import TerminalStatus
from analysis.recordings.flight_logs.autopilot_logs import is_autopilot_log
from analysis.recordings.flight_logs.log_condition import LogCondition
from analysis.recordings.gnss.receiver_logs import is_receiver_log
from analysis.recordings.position_reference import PositionReference, read_reference
from analysis.recordings.read_recordings import read_log, read_rinex
from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.judging.flight_signals import judge_requirements
from analysis.report.recordings.flight_sources import read_flight
from analysis.report.recordings.thinning import read_contents
from analysis.report.run_folder import ResultFile, make_folder, write_summary
from analysis.results import Result
from analysis.run.stop_signal import StopCheck, stop_requests
from analysis.run.terminal_summary import show_summary
from analysis.run.vehicle_judging import add_requirements, report_unmatched_faults
from analysis.samples.block import Block
from analysis.samples.link_buffer import LinkBuffer
from analysis.scoring.criteria import Criteria, CriterionCheck, receiver_criteria
from analysis.scoring.integrity import Integrity
from analysis.scoring.position_scores import PositionScores
from analysis.scoring.requirements import Requirement, read_requirements
from analysis.work_progress import WorkProgress
from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.recorder import encode_lines
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.documents.atomic_file import write_private
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.links.bus import Bus, open_run_bus
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.schedule.entries import read_schedule
from mavproxy_fault.wire.label import Label, latest_labels, read_labels

if TYPE_CHECKING:
    from analysis.detection.learn_noise import RecordedNoise

PART_ROWS = 500  # rows of a recording between two checks for a stop request

ResultSink = Callable[[list[Result]], None]


def main(args: argparse.Namespace) -> int:
    """Monitor until the source ends, the time is over or Ctrl-C; return the verdict's exit code."""
    config, criteria, requirements = monitor_settings(args)
    if args.calibrate is not None:
        return calibrate_to(Path(args.calibrate), args, config)
    reference = None if args.truth is None else read_reference(args.truth)
    if args.rinex is not None:
        config = msgspec.structs.replace(config, streams=False)  # a file has no link to test
        criteria = criteria if args.scenario else receiver_criteria(reference is not None)
    elif args.log is not None and Path(args.log).is_file() and is_autopilot_log(Path(args.log)):
        config = msgspec.structs.replace(config, link=False)
    # On a link, the proxy is still writing the labels: they are read again at the end.
    if args.link is None and args.labels is not None:
        read_labels(Path(args.labels))  # report a wrong name before the work
    # Read before the folder is made, since it may fail.
    recording = None if args.rinex is None else read_rinex_block(args)
    config, learned = learn_from(recording, config)
    folder = make_folder(args.out, "monitor") if args.out else None
    monitor, integrity = Monitor(config, reference), Integrity(reference)
    found: list[Result] = []  # for the requirements
    condition, started_s = LogCondition(), time.monotonic()
    with contextlib.ExitStack() as stack:
        bus = stack.enter_context(open_results_bus(args))
        publisher = Publisher(bus) if bus else None
        file = stack.enter_context(ResultFile(folder)) if folder else None
        watch = stack.enter_context(TerminalStatus()) if args.watch else None

        def deliver(results: list[Result]) -> None:
            integrity.add(results)
            found.extend(results if requirements else ())
            if file is not None:
                file.write(results)
            if publisher is not None:
                publisher.publish(results)
            if watch is not None:
                watch.show(results)

        stop = stack.enter_context(stop_requests())
        injected = None if recording is None else recording[1]
        if recording is not None:
            monitor_recording(recording[0], monitor, deliver, stop)
        else:
            _monitor_source(args, monitor, deliver, stop, condition)
    given = None if args.labels is None else read_labels(Path(args.labels))
    labels = given if injected is None else latest_labels(injected)
    if labels is None:  # without labels, no fault can count as missed
        criteria = msgspec.structs.replace(criteria, must_detect=(), must_isolate=())
    summary = monitor.summary(labels, criteria, time.monotonic() - started_s)
    report_log_damage(summary, condition)
    judge_log(summary, args.log, requirements, labels or [], found)
    if injected is not None:
        report_unmatched_faults(summary, read_schedule(args.schedule), injected)
    summary |= {"noise": learned.describe()} if learned is not None else {}
    summary |= {"integrity": integrity.summary()} if reference is not None else {}
    if folder is not None:
        write_summary(folder, summary)
        if injected is not None:
            write_private(folder / "labels.jsonl", encode_lines(injected))
        _report(args, folder, labels or [], summary, (reference, integrity, monitor.positions))
    return show_summary(args, summary, folder)


def judge_log(
    summary: dict[str, Any],
    log: str,
    requirements: Sequence[Requirement],
    labels: Sequence[Label],
    results: Sequence[Result],
) -> None:
    """Add the requirements, as the flight of a log meets them, to a summary."""
    if requirements:
        flight = add_derived_curves(read_flight([Path(log)], labels).recording)
        add_requirements(summary, judge_requirements(requirements, flight, labels, results))


def open_results_bus(args: argparse.Namespace) -> contextlib.AbstractContextManager[Bus | None]:
    """Open the bus for results; for recordings only if --zenoh is given."""
    choice = "off" if args.zenoh == "auto" and args.link is None else args.zenoh
    return open_run_bus(choice, "live", "monitor", args.zenoh_config)


def monitor_settings(
    args: argparse.Namespace,
) -> tuple[MonitorConfig, Criteria, tuple[Requirement, ...]]:
    """Return monitor settings with a noise model, criteria and requirements, of a scenario or the
    defaults."""
    config, criteria = MonitorConfig(), Criteria()
    requirements = read_requirements("--require", args.require)
    if args.scenario is not None:
        from analysis.run.run_setup import read_setup

        setup = read_setup(args.scenario)
        config, criteria = setup.monitor, setup.criteria
        requirements += setup.requirements
    if args.rinex is None and args.schedule is not None:
        raise ConfigError("--schedule: needs --rinex; use `replay` to inject faults into a log")
    if args.require and args.log is None:
        raise ConfigError("--require: needs a complete flight; give --log")
    if args.sigma is not None:
        from analysis.detection.learn_noise import read_sigma

        detector = msgspec.structs.replace(config.detector, sigma=read_sigma(Path(args.sigma)))
        config = msgspec.structs.replace(config, detector=detector)
    return config, criteria, requirements if args.log else ()


def calibrate_to(path: Path, args: argparse.Namespace, config: MonitorConfig) -> int:
    """Fit the noise model of pseudoranges to a fault-free recording and write it."""
    if args.link is not None:
        # The fit iterates over the samples.
        raise ConfigError("--calibrate: cannot use a live link; give --log or --rinex")
    from analysis.detection.learn_noise import learn_noise, write_sigma

    samples = [sample for block in read_blocks(args) for sample in block.samples()]
    found = learn_noise(samples, config.detector)
    if found is None:
        raise ConfigError(
            "--calibrate: fewer than 20 epochs can be solved; give a longer recording"
        )
    with users_path(f"--calibrate {path}", "give a file that can be written"):
        write_sigma(path, found)
    text = f"{path}: {found.describe()}; use it with --sigma {path}"
    print_result(args, {"file": path, "fit": found}, text)
    return 0


def learn_from(
    recording: tuple[Block, list[Label] | None] | None, config: MonitorConfig
) -> tuple[MonitorConfig, "RecordedNoise | None"]:
    """The settings with the noise that a RINEX recording shows, and what was learnt; as they are
    where they name a noise."""
    if recording is None or config.detector.sigma != SigmaModel():
        return config, None
    from analysis.detection.learn_noise import learn_noise

    learned = learn_noise(recording[0].samples(), config.detector)
    if learned is None:
        return config, None
    detector = msgspec.structs.replace(config.detector, sigma=learned.sigma)
    return msgspec.structs.replace(config, detector=detector), learned


def report_log_damage(summary: dict[str, Any], condition: LogCondition) -> None:
    """Add the data lost in a log to a summary; a corrupted log cannot pass."""
    if condition.damage:
        evidence = "; ".join(condition.damage)
        check = CriterionCheck(
            name="log is complete", limit="complete", value=evidence, passed=None
        )
        summary["criteria"].append(msgspec.structs.asdict(check))
        if summary["verdict"] == "PASS":
            summary["verdict"] = "NO VERDICT"
    summary["log"] = {
        "damage": condition.damage,
        "lost_s": round(sum(end - begin for begin, end in condition.lost_us) * 1e-6, 3),
    }


def _monitor_source(
    args: argparse.Namespace,
    monitor: Monitor,
    deliver: ResultSink,
    stop: StopCheck,
    condition: LogCondition,
) -> None:
    """Monitor a link or a log to its end; `condition` collects the data lost in a log."""
    if args.link is not None:
        monitor_link(args.link, monitor, deliver, args.for_s, stop)
        return
    for block in read_log(args.log, condition):
        monitor.set_log_gaps(condition.lost_us)
        deliver(monitor.push(block))
        if stop():
            break


def monitor_recording(block: Block, monitor: Monitor, deliver: ResultSink, stop: StopCheck) -> None:
    """Feed a complete recording to the monitor, some rows at a time: a day takes a minute."""
    sky, count = RecordedSky(block, monitor.detector), len(block.kind)
    spans_s = (block.t_us - block.t_us[0]) * 1e-6
    with WorkProgress("monitoring", float(spans_s[-1])) as progress:
        for begin in range(0, count, PART_ROWS):
            end = min(begin + PART_ROWS, count)
            deliver(sky.add_sky(monitor.push(block.between(begin, end))))
            progress.show(float(spans_s[end - 1]))
            if stop():
                break


def read_blocks(args: argparse.Namespace) -> Iterator[Block]:
    """Yield the samples of the given recording."""
    if args.log is not None:
        yield from read_log(args.log)
    else:
        yield read_rinex_block(args)[0]


def read_rinex_block(args: argparse.Namespace) -> tuple[Block, list[Label] | None]:
    """Read a RINEX recording, inject the faults of `--schedule`, and return it with the labels."""
    obs, *nav = (Path(path) for path in args.rinex)
    if is_receiver_log(obs) and args.schedule is not None:
        raise ConfigError(f"--schedule: {obs} is a receiver log; faults need a RINEX file")
    if not nav and not is_receiver_log(obs):
        raise ConfigError(f"--rinex {obs}: navigation file is missing; give OBS NAV")
    lines = labels = None
    if args.schedule is not None:
        lines, labels = faulted_lines(obs, read_schedule(args.schedule), nav)
    return read_rinex(obs, nav, Path(args.imu) if args.imu else None, lines), labels


def monitor_link(
    spec: str, monitor: Monitor, deliver: ResultSink, for_s: float | None, stop: StopCheck
) -> None:
    """Feed the monitor from a link until `for_s` seconds of vehicle time have passed."""
    link = open_link(spec)
    with LinkBuffer(link) as intake:
        print(f"monitoring {link.name}", file=sys.stderr, flush=True)
        # In vehicle time, which a paused simulator does not advance.
        while not stop() and (for_s is None or monitor.t_s < for_s):
            deliver(monitor.push_bytes(intake.drain(), datagrams=link.datagrams))
    if intake.drops:
        print(f"{intake.drops} chunks were lost: the monitor was too slow", file=sys.stderr)


def _report(
    args: argparse.Namespace,
    folder: Path,
    labels: Sequence[Label],
    summary: dict[str, object],
    accuracy: tuple[PositionReference | None, Integrity, PositionScores],
) -> None:
    from analysis.report.run_report import write_run_report
    from analysis.results import read_results

    results = list(read_results(folder / "results.jsonl"))
    extras: dict[str, Any] = {}
    if args.rinex:
        from analysis.report.receiver_files import receiver_files

        extras = receiver_files(folder, results, labels, *accuracy)
    title = Path(args.log or args.rinex[0]).name if args.log or args.rinex else folder.name
    write_run_report(
        folder,
        summary=summary,
        labels=labels,
        results=results,
        # Autopilot logs have no MAVLink columns.
        columns=read_contents(Path(args.log), lambda _: None).columns
        if args.log and not is_autopilot_log(Path(args.log))
        else {},
        title=title,
        **extras,
    )
