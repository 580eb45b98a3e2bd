"""The simulator's subcommand; what it needs is imported when it runs."""

import argparse
from typing import Any


def add_sim(commands: Any) -> None:
    """`sim`: the simulator alone."""
    parser = commands.add_parser("sim", help="the vehicle simulator alone, or under an autopilot")
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    parser.add_argument("--hil", metavar="EP", help="HIL frames here; tcpin:127.0.0.1:4560 for PX4")
    parser.add_argument(
        "--gcs", metavar="EP", help="telemetry and commands, e.g. udpout:127.0.0.1:14550"
    )
    parser.add_argument(
        "--real-time", action="store_true",
        help="an autopilot on its own board: wait for no answer (so on serial devices)",
    )  # fmt: skip
    parser.add_argument("--speed", default="1", metavar="1|N|max", help="times real time")
    parser.add_argument("--seed", type=int, metavar="N", help="(default: the scenario's)")
    parser.add_argument("--plot", metavar="PNG", help="fly without links and draw path and states")
    parser.set_defaults(main=_sim)


def _sim(args: argparse.Namespace) -> int:
    from simvehicle.app.sim_server import main

    return main(args)
