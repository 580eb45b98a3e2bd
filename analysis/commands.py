"""Subcommands of the analysis; each imports its modules when it runs."""

import argparse
import contextlib
import sys
from typing import Any

from mavproxy_fault.app.command_parser import positive_count
from mavproxy_fault.app.command_result import add_json
from mavproxy_fault.app.commands import add_bus, add_router, main_of


def add_run(commands: Any) -> None:
    """`run`: simulator, proxy, monitor and report from one scenario."""
    parser = commands.add_parser("run", help="fly a scenario: simulator + proxy + monitor + report")
    _add_scenario(parser)
    _add_requirements(parser)
    parser.add_argument(
        "--estimators", metavar="ESTIMATORS",
        help="attitude estimators to score, comma-separated (default: the scenario's)",
    )  # fmt: skip
    # No default here, since it depends on --ui: a live page needs real time.
    parser.add_argument(
        "--speed", metavar="1|N|max", help="times real time (default: max, with --ui 1)"
    )
    out = "folder for logs and results (default: runs/NUMBER-NAME)"
    parser.add_argument("--out", "--logdir", metavar="DIR", help=out)
    parser.add_argument(
        "--gcs", default="udpout:127.0.0.1:14550", metavar="EP|off",  # where QGroundControl listens
        help="ground station, unless --speed max (default: udpout:127.0.0.1:14550)",
    )  # fmt: skip
    parser.add_argument(
        "--ui", action="store_true", help="serve the web page for fault control and live view"
    )
    add_bus(parser, "results")
    parser.add_argument(
        "--against-clean", action="store_true",
        help="also fly a fault-free reference flight and report the effect of each fault",
    )  # fmt: skip
    parser.add_argument(
        "--no-report", dest="report", action="store_false",
        help="write only the logs, results and summary",
    )  # fmt: skip
    parser.add_argument(
        "--autopilot",
        choices=("ardupilot", "ardupilot:copter", "ardupilot:plane", "px4"),
        help="autopilot that flies the scenario's vehicle (default: the built-in controller)",
    )
    parser.add_argument(
        "--binary", metavar="PATH", help="its SITL binary (default: arducopter, arduplane, px4)"
    )
    parser.add_argument(
        "--parameters", metavar="FILE",
        help="parameters of the autopilot, one NAME VALUE per line, override those of the run",
    )  # fmt: skip
    parser.add_argument(
        "--from", dest="count_from", default="take-off", metavar="EVENT",  # `args.from` is no name
        help="flight event from which at_s counts (autopilot): first-stamp, arming, take-off, "
        "mission-item:N, landing",
    )  # fmt: skip
    add_json(parser)
    # The command line calls the `main` of the chosen subcommand.
    parser.set_defaults(main=_run)


def _add_scenario(parser: argparse.ArgumentParser) -> None:
    """Add the scenario and the options that replace parts of it."""
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    parser.add_argument("--schedule", metavar="YAML", help="faults (default: the scenario's)")
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of all random numbers (default: the scenario's)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE",
        help="set a value of the scenario, such as environment.wind_ned_mps[0]=5; repeatable",
    )  # fmt: skip


def _add_requirements(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--require",
        action="append",
        default=[],
        metavar="FORMULA|NAME",
        help="requirement in Signal Temporal Logic, or one of the library; repeatable",
    )


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
    source.add_argument("--link", metavar="EP", help="live MAVLink, e.g. udpin:127.0.0.1:14551")
    source.add_argument("--log", metavar="LOG", help="tlog, ULog or dataflash log")
    # The first file holds the observations; each system may have its own navigation file.
    source.add_argument(
        "--rinex", nargs="+", metavar="FILE",
        help="RINEX 2, 3 or 4: OBS NAV [NAV ...]; or a receiver log [NAV ...]: u-blox LOG.ubx (or"
        " LOG.ulg of PX4, LOG.bin of ArduPilot), Septentrio LOG.sbf",
    )  # fmt: skip
    parser.add_argument("--imu", metavar="CSV", help="IMU samples for --rinex")
    parser.add_argument("--schedule", metavar="YAML", help="faults to inject into the --rinex file")
    parser.add_argument(
        "--truth", metavar="POINT|FILE",
        help="true antenna position: X,Y,Z or LAT,LON,HEIGHT, a .pos file, or a CSV",
    )  # fmt: skip
    parser.add_argument("--labels", metavar="FILE", help="labels of the injected faults, to score")
    parser.add_argument("--out", metavar="DIR", help="folder for results and report")
    parser.add_argument("--watch", action="store_true", help="show a compact live status")
    parser.add_argument(
        "--scenario", metavar="YAML", help="monitor settings and criteria (default: built in)"
    )
    parser.add_argument(
        "--calibrate", metavar="FILE", help="fit the pseudorange noise to fault-free data, write it"
    )
    parser.add_argument("--sigma", metavar="FILE", help="noise model written by --calibrate")
    parser.add_argument(
        "--for", dest="for_s", type=float, metavar="S",
        help="end after S seconds of vehicle time (default: no limit)",
    )  # fmt: skip
    _add_requirements(parser)
    add_bus(parser, "results")
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.run.monitor_command"))


def add_search(commands: Any) -> None:
    """`search`: find the worst case of an estimator."""
    parser = commands.add_parser("search", help="random and optimised search for the worst case")
    parser.add_argument("testfile", metavar="TESTFILE", help="test file with the ranges (YAML)")
    parser.add_argument(
        "--budget", type=int, metavar="N", help="evaluations (default: the file's, or 2000)"
    )
    parser.add_argument(
        "--method", choices=("random", "matyas", "sobol", "cmaes", "de", "mixed"),
        help="how to search (default: the file's)",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, metavar="N", help="random seed (default: the file's)")
    parser.add_argument(
        "--violate",
        metavar="REQUIREMENT",
        help="search for flights that violate a requirement: a formula or a name",
    )
    parser.add_argument(
        "--first", action="store_true", default=None, help="stop at the first that violates it"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=positive_count, metavar="N", help="processes on this machine (default: 1)"
    )
    where.add_argument("--ray", metavar="ADDRESS", help="address of a Ray cluster")
    parser.add_argument("--out", metavar="DIR", help="output folder (default: runs/NUMBER-NAME)")
    parser.add_argument(
        "--interactive", action="store_true", help="inspect the tests one by one on a web page"
    )
    add_json(parser)
    parser.set_defaults(main=_search)


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
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers", type=positive_count, metavar="N", help="processes (default: all cores)"
    )
    where.add_argument("--ray", metavar="ADDRESS", help="address of a Ray cluster")
    parser.add_argument(
        "--out", metavar="DIR", help="new or unfinished campaign's folder (default: in runs/)"
    )
    parser.add_argument("--dataset", metavar="DIR", help="write the flights as a labelled data set")
    parser.add_argument(
        "--evidence", metavar="DIR", help="write failure modes, effects and requirements as tables"
    )
    parser.add_argument("--build", metavar="CMD", help="of bisect: builds a commit")
    parser.add_argument(
        "--binary", metavar="PATH", help="of bisect: the autopilot's program that CMD builds"
    )
    parser.add_argument("--dry-run", action="store_true", help="print only the size and duration")
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.campaign.campaign_command"))


def add_report(commands: Any) -> None:
    """`report`: a verdict and a page from logs."""
    parser = commands.add_parser("report", help="tlog, ULog or dataflash log to HTML and JSON")
    parser.add_argument("logs", nargs="+", metavar="LOG", help="logs, or one folder of logs")
    parser.add_argument("--labels", metavar="FILE", help="labels of the injected faults")
    parser.add_argument(
        "--against", action="append", default=[], metavar="LOG", help="log to compare with"
    )
    parser.add_argument(
        "--criteria", metavar="YAML", help="thresholds of the checks (default: built in)"
    )
    parser.add_argument("--out", metavar="DIR", help="output folder (default: LOG-report)")
    parser.add_argument("--figures", action="store_true", help="also write plots as PNG, SVG, PDF")
    parser.add_argument(
        "--export", choices=("csv", "parquet", "mcap", "kml", "geojson"),
        help="export the data as tables or the tracks as map files",
    )  # fmt: skip
    parser.add_argument("--pdf", action="store_true", help="also write a PDF (needs a browser)")
    parser.add_argument(
        "--data", default="2", metavar="MB|beside",  # text, as it is a number or a word
        help="fields for the page's search: MB megabytes in the page (2), or all beside it",
    )  # fmt: skip
    add_json(parser)
    parser.set_defaults(main=main_of("analysis.report.report_command"))


def add_ui(commands: Any) -> None:
    """`ui`: the web page."""
    parser = commands.add_parser("ui", help="web page that controls faults and shows a live proxy")
    # No default: only the default port, not a requested one, may be replaced by a free one.
    parser.add_argument("--port", type=int, help="TCP port (default: 8350, or a free one if taken)")
    parser.add_argument(
        "--allow-commands", action="store_true",
        help="allow the page to command the vehicle (arm, take off, ...), if the proxy does too",
    )  # fmt: skip
    parser.add_argument(
        "--sequences", metavar="DIR", help="folder for the test sequences of the page"
    )
    add_router(parser)
    parser.set_defaults(main=main_of("analysis.web.page_server"))
