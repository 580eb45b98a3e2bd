"""The analysis' subcommands; what they need is imported when they run."""

import argparse
import contextlib
import sys
from typing import Any

from mavproxy_fault.app.commands import add_bus, add_router


def add_run(commands: Any) -> None:
    """`run`: simulator, proxy, monitor and report from one scenario."""
    parser = commands.add_parser(
        "run", help="play a scenario: simulator + proxy + monitor + report"
    )
    _add_scenario(parser)
    # No default here, as it hangs on --ui: whoever watches a page wants real time.
    parser.add_argument(
        "--speed", metavar="1|N|max", help="times real time (default: max, with --ui 1)"
    )
    out = "folder of logs and results (default: runs/ and a number)"
    parser.add_argument("--out", "--logdir", metavar="DIR", help=out)
    parser.add_argument(
        "--gcs",
        default="udpout:127.0.0.1:14550",  # where QGroundControl listens
        metavar="EP|off",
        help="ground station, unless --speed max (default: udpout:127.0.0.1:14550)",
    )
    parser.add_argument(
        "--ui", action="store_true", help="serve the page for control and live view"
    )
    add_bus(parser, "results")
    parser.add_argument(
        "--against-clean",
        action="store_true",
        help="fly the same without the faults beside it, and tell what each fault did",
    )
    parser.add_argument(
        "--no-report",
        dest="report",
        action="store_false",
        help="write the logs, results and summary alone",
    )
    parser.add_argument(
        "--autopilot",
        choices=("ardupilot", "ardupilot:copter", "ardupilot:plane", "px4"),
        help="who flies (default: the built-in controller); ArduPilot's vehicle is the scenario's",
    )
    parser.add_argument(
        "--binary", metavar="PATH", help="its SITL program (default: arducopter, arduplane, px4)"
    )
    parser.add_argument(
        "--parameters",
        metavar="FILE",
        help="its parameters, NAME VALUE a line (default: the run's own alone)",
    )
    parser.add_argument(
        "--from",
        dest="count_from",  # `args.from` would be no Python
        default="take-off",
        metavar="MOMENT",
        help="what at_s counts from under an autopilot: first-stamp, arming, take-off, "
        "mission-item:N, landing",
    )
    # The command line calls `main` of the subcommand that was named.
    parser.set_defaults(main=_run)


def _add_scenario(parser: argparse.ArgumentParser) -> None:
    """The scenario, and what is put in the place of parts of it."""
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    parser.add_argument(
        "--schedule", metavar="FILE", help="faults to use (default: the scenario's)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="for all that is random (default: the scenario's)"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="a value of the scenario, such as environment.wind_ned_mps[0]=5; may be given again",
    )


def _run(args: argparse.Namespace) -> int:
    # Imported here, and so below: numba and GTSAM load slowly, and `--help` needs neither.
    from analysis.run.monitor_process import MonitorDiedError

    try:
        return _run_scenario(args)
    except MonitorDiedError as died:
        # No mistake of the user's, hence 1 and not 2.
        print(f"mavproxy-fault: {died}; the logs up to then are in the run folder", file=sys.stderr)
        return 1


def _run_scenario(args: argparse.Namespace) -> int:
    with contextlib.ExitStack() as stack:
        if args.ui:
            from analysis.web.page_server import serve_beside

            # Around the whole run: the page is there from the first frame to the last.
            stack.enter_context(serve_beside(args))
        if args.autopilot:
            # Loaded only here: an autopilot's run needs other parts.
            from analysis.autopilots.autopilot_run import main as fly

            return fly(args)
        from analysis.run.run_command import main

        return main(args)


def add_monitor(commands: Any) -> None:
    """`monitor`: detection, fusion and scores on a link or a log."""
    parser = commands.add_parser("monitor", help="detect and isolate faults on a link or a log")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--link", metavar="EP", help="live MAVLink, e.g. udpin:127.0.0.1:14551")
    source.add_argument("--log", metavar="LOG", help="a tlog, ULog or dataflash log")
    # The first holds the observations; each system's navigation may be a file of its own.
    source.add_argument(
        "--rinex",
        nargs="+",
        metavar="FILE",
        help="RINEX 2, 3 or 4: OBS NAV [NAV ...]; or a receiver's log [NAV ...]: u-blox LOG.ubx (or"
        " PX4's LOG.ulg, ArduPilot's LOG.bin), Septentrio LOG.sbf",
    )
    parser.add_argument("--imu", metavar="CSV", help="IMU samples to go with --rinex")
    parser.add_argument("--schedule", metavar="FILE", help="faults to put into the --rinex file")
    parser.add_argument(
        "--truth",
        metavar="POINT|FILE",
        help="where the antenna was: X,Y,Z or LAT,LON,HEIGHT, a .pos file, or a CSV",
    )
    parser.add_argument("--labels", metavar="FILE", help="what was injected, to score against")
    parser.add_argument("--out", metavar="DIR", help="write results and report here")
    parser.add_argument("--watch", action="store_true", help="a compact live status")
    parser.add_argument(
        "--scenario", metavar="FILE", help="its monitor and criteria (default: built in)"
    )
    parser.add_argument(
        "--calibrate", metavar="FILE", help="fit the noise of pseudoranges to clean data, write it"
    )
    parser.add_argument("--sigma", metavar="FILE", help="a noise model that --calibrate wrote")
    parser.add_argument(
        "--for",
        dest="for_s",
        type=float,
        metavar="S",
        help="end after S seconds of vehicle time (default: never)",
    )
    add_bus(parser, "results")
    parser.set_defaults(main=_monitor)


def _monitor(args: argparse.Namespace) -> int:
    from analysis.run.monitor_command import main

    return main(args)


def add_search(commands: Any) -> None:
    """`search`: the worst case of an estimator."""
    parser = commands.add_parser("search", help="random and optimised search for the worst case")
    parser.add_argument("testfile", metavar="TESTFILE", help="what to vary and how far (YAML)")
    parser.add_argument(
        "--budget", type=int, metavar="N", help="evaluations (default: the file's, or 2000)"
    )
    parser.add_argument(
        "--method",
        metavar="M",
        help="random, matyas, sobol, cmaes, de or mixed (default: the file's)",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="(default: the file's)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=int, metavar="N", help="processes on this machine (default: 1)"
    )
    where.add_argument("--ray", metavar="ADDRESS", help="a Ray cluster")
    parser.add_argument("--out", metavar="DIR", help="(default: runs/ and a number)")
    parser.add_argument(
        "--interactive", action="store_true", help="look at one test after the other, on a page"
    )
    parser.set_defaults(main=_search)


def _search(args: argparse.Namespace) -> int:
    if args.interactive:
        from analysis.search_page.search_server import main as look

        return look(args)
    from analysis.search.search_command import main

    return main(args)


def add_campaign(commands: Any) -> None:
    """`campaign`: many flights with faults, and what becomes of them."""
    parser = commands.add_parser(
        "campaign", help="which faults, how large and when, break an estimator or autopilot"
    )
    parser.add_argument(
        "file",
        nargs="+",
        metavar="FILE",
        help="campaign (YAML); or: compare BEFORE AFTER; or: search DIR [CELL]",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="processes (default: all cores)")
    where.add_argument("--ray", metavar="ADDRESS", help="a Ray cluster")
    parser.add_argument(
        "--out", metavar="DIR", help="one that was begun goes on (default: runs/ and a number)"
    )
    parser.add_argument("--dataset", metavar="DIR", help="the flights as a labelled data set")
    parser.add_argument("--dry-run", action="store_true", help="tell the size and the time only")
    parser.set_defaults(main=_campaign)


def _campaign(args: argparse.Namespace) -> int:
    from analysis.campaign.campaign_command import main

    return main(args)


def add_report(commands: Any) -> None:
    """`report`: a verdict from logs."""
    parser = commands.add_parser("report", help="tlog, ULog or dataflash log to HTML and JSON")
    parser.add_argument("logs", nargs="+", metavar="LOG", help="logs, or one folder of many")
    parser.add_argument("--labels", metavar="FILE", help="what was injected")
    parser.add_argument(
        "--against", action="append", default=[], metavar="LOG", help="a log to compare with"
    )
    parser.add_argument(
        "--criteria", metavar="FILE", help="thresholds of the checks, YAML (default: built in)"
    )
    parser.add_argument("--out", metavar="DIR", help="(default: LOG's name and -report)")
    parser.add_argument("--figures", action="store_true", help="every plot as PNG, SVG and PDF too")
    parser.add_argument(
        "--export",
        choices=("csv", "parquet", "mcap", "kml", "geojson"),
        help="the data as tables, or the tracks for maps",
    )
    parser.add_argument("--pdf", action="store_true", help="print the report, by a browser")
    parser.add_argument(
        "--data",
        default="2",  # text, as it is a number or a word
        metavar="MB|beside",
        help="any field for the page's search: so many MB in the file (2), or all beside it",
    )
    parser.set_defaults(main=_report)


def _report(args: argparse.Namespace) -> int:
    from analysis.report.report_command import main

    return main(args)


def add_ui(commands: Any) -> None:
    """`ui`: the page."""
    parser = commands.add_parser("ui", help="the page: control faults and watch a running proxy")
    # Without a default: only ours may give way to a free port, not one that was asked for.
    parser.add_argument("--port", type=int, help="(default: 8350, or a free one if taken)")
    parser.add_argument(
        "--allow-commands", action="store_true",
        help="let the page command the vehicle: arm, take off, ... (the proxy must allow it too)",
    )  # fmt: skip
    parser.add_argument(
        "--sequences", metavar="DIR", help="keep the page's test sequences in a folder"
    )
    add_router(parser)
    parser.set_defaults(main=_ui)


def _ui(args: argparse.Namespace) -> int:
    from analysis.web.page_server import main

    return main(args)
