"""Subcommands of the analysis; each imports its modules when it runs."""

import argparse
import contextlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

from mavproxy_fault.app.command_parser import add_json, add_option, positive_count
from mavproxy_fault.app.commands import add_bus, add_router, main_of

AUTOPILOTS = ("ardupilot", "ardupilot:copter", "ardupilot:plane", "px4")
METHODS = ("random", "matyas", "sobol", "cmaes", "mixed")


def add_run(commands: Any) -> None:
    """`run`: simulator, proxy, monitor and report from one scenario."""
    parser = commands.add_parser("run", help="fly a scenario: simulator + proxy + monitor + report")
    option = partial(add_option, parser)
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    option("--schedule YAML", "faults (default: the scenario's)")
    option("--seed N", "seed of all random numbers (default: the scenario's)", type=int)
    option(
        "--set PATH=VALUE...", "set a value of the scenario, such as environment.wind_ned_mps[0]=5"
    )
    _add_requirements(parser)
    scored = "attitude estimators to score, comma-separated (default: the scenario's)"
    option("--estimators ESTIMATORS", scored)
    # No default here, since it depends on --ui: a live page needs real time.
    option("--speed 1|N|max", "times real time (default: max, with --ui 1)")
    option("--out --logdir DIR", "folder for logs and results (default: runs/NUMBER-NAME)")
    station = "udpout:127.0.0.1:14550"  # where QGroundControl listens
    help = f"ground station, unless --speed max (default: {station})"
    option("--gcs EP|off", help, default=station)
    option("--ui", "serve the web page for fault control and live view")
    add_bus(parser, "results")
    clean = "also fly a fault-free reference flight and report the effect of each fault"
    option("--against-clean", clean)
    report = "write only the logs, results and summary"
    option("--no-report", report, dest="report", action="store_false")
    flying = "autopilot that flies the scenario's vehicle (default: the built-in controller)"
    option("--autopilot", flying, choices=AUTOPILOTS)
    option("--binary PATH", "its SITL binary (default: arducopter, arduplane, px4)")
    file = "parameters of the autopilot, one NAME VALUE per line, override those of the run"
    option("--parameters FILE", file)
    event = (
        "flight event from which at_s counts (autopilot): first-stamp, arming, take-off, "
        "mission-item:N, landing"
    )
    option("--from EVENT", event, dest="count_from", default="take-off")  # `from` is no name
    add_json(parser)
    # The command line calls the `main` of the chosen subcommand.
    parser.set_defaults(main=_run)


def _add_requirements(parser: argparse.ArgumentParser) -> None:
    help = "requirement in Signal Temporal Logic, or one of the library"
    add_option(parser, "--require FORMULA|NAME...", help)


def _run(args: argparse.Namespace) -> int:
    # Imported late, as below: numba and GTSAM load slowly, and `--help` needs neither.
    from analysis.run.monitor_process import MonitorDiedError

    try:
        return _run_scenario(args)
    except MonitorDiedError as died:
        # Exit code 2 is for wrong input.
        print(f"mavproxy-fault: {died}; the run folder has the logs up to then", file=sys.stderr)
        return 1


def _run_scenario(args: argparse.Namespace) -> int:
    with contextlib.ExitStack() as stack:
        if args.ui:
            from analysis.web.page_server import serve_beside

            # The page is available from the first frame to the last.
            stack.enter_context(serve_beside(args))
        module = "autopilots.autopilot_run" if args.autopilot else "run.run_command"
        return main_of(f"analysis.{module}")(args)


def add_monitor(commands: Any) -> None:
    """`monitor`: fault detection, fusion and scores on a link or a log."""
    parser = commands.add_parser("monitor", help="detect and isolate faults on a link or a log")
    source = parser.add_mutually_exclusive_group(required=True)
    add_option(source, "--link EP", "live MAVLink, e.g. udpin:127.0.0.1:14551")
    add_option(source, "--log LOG", "tlog, ULog or dataflash log")
    # The first file holds the observations; each system may have its own navigation file.
    rinex = (
        "RINEX 2, 3 or 4: OBS NAV [NAV ...]; or a receiver log [NAV ...]: u-blox LOG.ubx (or"
        " LOG.ulg of PX4, LOG.bin of ArduPilot), Septentrio LOG.sbf, Android LOG.txt, LOG.rtcm3;"
        " precise ORBITS.sp3 and CLOCKS.clk beside NAV"
    )
    add_option(source, "--rinex FILE", rinex, nargs="+")
    option = partial(add_option, parser)
    option("--imu CSV", "IMU samples for --rinex")
    option("--schedule YAML", "faults to inject into the --rinex file")
    truth = "true antenna position: X,Y,Z or LAT,LON,HEIGHT, a .pos file, or a CSV"
    option("--truth POINT|FILE", truth)
    option("--labels FILE", "labels of the injected faults, to score")
    option("--out DIR", "folder for results and report")
    option("--watch", "show a compact live status")
    option("--scenario YAML", "monitor settings and criteria (default: built in)")
    option("--calibrate FILE", "fit the pseudorange noise to fault-free data, write it")
    option("--sigma FILE", "noise model written by --calibrate")
    end = "end after S seconds of vehicle time (default: no limit)"
    option("--for S", end, dest="for_s", type=float)
    _add_requirements(parser)
    add_bus(parser, "results")
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.run.monitor_command"))


def add_search(commands: Any) -> None:
    """`search`: find the worst case of an estimator."""
    parser = commands.add_parser("search", help="random and optimised search for the worst case")
    parser.add_argument("testfile", metavar="TESTFILE", help="test file with the ranges (YAML)")
    option = partial(add_option, parser)
    option("--budget N", "evaluations (default: the file's, or 2000)", type=int)
    option("--method", "search method (default: the one in the file)", choices=METHODS)
    option("--seed N", "random seed (default: the file's)", type=int)
    violate = "search for flights that violate a requirement: a formula or a name"
    option("--violate REQUIREMENT", violate)
    option("--first", "stop at the first that violates it", default=None)
    _add_workers(parser, "processes on this machine (default: 1)")
    option("--out DIR", "output folder (default: runs/NUMBER-NAME)")
    option("--interactive", "inspect the tests one by one on a web page")
    add_json(parser)
    parser.set_defaults(main=_search)


def _add_workers(parser: argparse.ArgumentParser, help: str) -> None:
    where = parser.add_mutually_exclusive_group()
    add_option(where, "--workers N", help, type=positive_count)
    add_option(where, "--ray ADDRESS", "address of a Ray cluster")


def _search(args: argparse.Namespace) -> int:
    module = "search_page.search_server" if args.interactive else "search.search_command"
    return main_of(f"analysis.{module}")(args)


def add_campaign(commands: Any) -> None:
    """`campaign`: many flights with faults, and their outcomes."""
    parser = commands.add_parser(
        "campaign", help="find which faults, how large and when, break an estimator or autopilot"
    )
    parser.add_argument(
        "file", nargs="+", metavar="YAML",
        help="campaign file; or: compare BEFORE AFTER (baseline.json); or: search DIR [CELL]; or: "
        "bisect FILE GOOD BAD",
    )  # fmt: skip
    _add_workers(parser, "processes (default: all cores)")
    option = partial(add_option, parser)
    option("--out DIR", "new or unfinished campaign's folder (default: in runs/)")
    option("--dataset DIR", "write the flights as a labelled data set")
    option("--evidence DIR", "write failure modes, effects and requirements as tables")
    option("--build CMD", "of bisect: builds a commit")
    option("--binary PATH", "of bisect: the autopilot's program that CMD builds")
    option("--sample N", "fly only N cells of each subject, drawn at random", type=positive_count)
    option("--dry-run", "print only the size and duration")
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.campaign.campaign_command"))


def add_report(commands: Any) -> None:
    """`report`: a verdict and a page from logs."""
    parser = commands.add_parser("report", help="tlog, ULog or dataflash log to HTML and JSON")
    parser.add_argument("logs", nargs="+", metavar="LOG", help="logs, or one folder of logs")
    option = partial(add_option, parser)
    option("--labels FILE", "labels of the injected faults")
    option("--against LOG...", "log to compare with")
    option("--criteria YAML", "thresholds of the checks (default: built in)")
    option("--out DIR", "output folder (default: LOG-report)")
    option("--figures", "also write plots as PNG, SVG, PDF")
    export = "export the data as tables or the tracks as map files"
    option("--export", export, choices=("csv", "parquet", "mcap", "rerun", "kml", "geojson"))
    option("--pdf", "also write a PDF (needs a browser)")
    data = "fields for the page's search: MB megabytes in the page (2), or all beside it"
    option("--data MB|beside", data, default="2")
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.report.report_command"))


def add_ui(commands: Any) -> None:
    """`ui`: the web page."""
    parser = commands.add_parser("ui", help="web page that controls faults and shows a live proxy")
    option = partial(add_option, parser)
    # No default: only the default port, not a requested one, may be replaced by a free one.
    option("--port PORT", "TCP port (default: 8350, or a free one if taken)", type=int)
    commanding = "allow the page to command the vehicle (arm, take off, ...), if the proxy does too"
    option("--allow-commands", commanding)
    option("--sequences DIR", "folder for the test sequences of the page", type=Path)
    add_router(parser)
    parser.set_defaults(main=main_of("analysis.web.page_server"))
