"""The `sim` subcommand; heavy modules are imported only when it runs."""

from functools import partial
from typing import Any

from mavproxy_fault.app.command_parser import add_option
from mavproxy_fault.app.commands import main_of


def add_sim(commands: Any) -> None:
    """Add the `sim` subcommand."""
    parser = commands.add_parser("sim", help="simulate a vehicle, alone or with an autopilot")
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="YAML (default: the demo)")
    option = partial(add_option, parser)
    option("--hil EP", "HIL endpoint; tcpin:127.0.0.1:4560 for PX4")
    option("--gcs EP...", "telemetry and commands, e.g. udpout:127.0.0.1:14550")
    board = "for an autopilot on its own board: do not wait for answers (default on serial links)"
    option("--real-time", board)
    option("--speed 1|N|max", "multiple of real time", default="1")
    option("--seed N", "random seed (default: the scenario's)", type=int)
    parser.set_defaults(main=main_of("simvehicle.app.sim_server"))
