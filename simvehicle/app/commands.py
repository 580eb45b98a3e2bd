"""The `sim` subcommand; heavy modules are imported only when it runs."""

import argparse
from typing import Any


def add_sim(commands: Any) -> None:
    """Add the `sim` subcommand."""
    parser = commands.add_parser("sim", help="simulate a vehicle, alone or with an autopilot")
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    parser.add_argument("--hil", metavar="EP", help="HIL endpoint; tcpin:127.0.0.1:4560 for PX4")
    parser.add_argument(
        "--gcs",
        action="append",
        default=[],
        metavar="EP",
        help="telemetry and commands, e.g. udpout:127.0.0.1:14550; repeatable",
    )
    parser.add_argument(
        "--real-time", action="store_true",
        help="for an autopilot on its own board: do not wait for answers (default on serial links)",
    )  # fmt: skip
    parser.add_argument("--speed", default="1", metavar="1|N|max", help="multiple of real time")
    parser.add_argument(
        "--seed", type=int, metavar="N", help="random seed (default: the scenario's)"
    )
    parser.add_argument("--plot", metavar="PNG", help="simulate without links; plot the flight")
    parser.set_defaults(main=_sim)


def _sim(args: argparse.Namespace) -> int:
    from simvehicle.app.sim_server import main

    return main(args)
