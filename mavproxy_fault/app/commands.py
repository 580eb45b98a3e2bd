"""The parsers of the proxy's subcommands, whose modules are imported when they run."""

import argparse
import gc
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from mavproxy_fault.app.command_result import add_json

AddCommand = Callable[[Any], None]
Main = Callable[[argparse.Namespace], int]

ENDPOINT = "connection string, e.g. udpin:127.0.0.1:14550, tcpin:127.0.0.1:4560, /dev/ttyUSB0,57600"


def main_of(module: str) -> Main:
    """Return the `main` of a command's module, which is imported when the command runs."""
    return partial(_run_main, module)  # other processes can receive it, unlike a closure


def _run_main(module: str, args: argparse.Namespace) -> int:
    run: Main = import_module(module).main
    return run(args)


def add_proxy(commands: Any) -> None:
    """`proxy`: the proxy between a vehicle and any number of other endpoints."""
    parser = commands.add_parser("proxy", help="forward MAVLink between links and apply faults")
    parser.add_argument("--master", required=True, metavar="EP", help=f"the vehicle: {ENDPOINT}")
    to = parser.add_argument(
        "--to", action="append", required=True, metavar="EP",
        help="ground station, autopilot ...; repeatable",
    )  # fmt: skip
    # MAVProxy's name, accepted but not shown: in our other commands it is the output.
    parser._option_string_actions["--out"] = to
    parser.add_argument("--schedule", metavar="YAML", help="faults to apply")
    parser.add_argument("--logdir", metavar="DIR", help="write tlogs and labels here")
    parser.add_argument(
        "--allow-peer", action="append", default=[], metavar="NET",
        help="address or network that udpin accepts; repeatable (default: any)",
    )  # fmt: skip
    parser.add_argument(
        "--lock-peer", action="store_true",
        help="restrict each udpin to the first peer that sends a valid frame",
    )  # fmt: skip
    parser.add_argument("--busy-poll", action="store_true", help="busy-wait for lowest latency")
    add_bus(parser, "control and statistics")
    parser.add_argument("--run", metavar="NAME", help="this proxy's name on Zenoh (default: live)")
    parser.add_argument(
        "--files", action="append", default=[], metavar="DIR",
        help="allow requests to read series files from this folder; repeatable (default: none)",
    )  # fmt: skip
    parser.add_argument(
        "--no-inject", dest="inject", action="store_false", help="refuse live faults"
    )
    parser.add_argument(
        "--allow-commands", action="store_true",
        help="allow schedules and live control to arm, fly and land the vehicle",
    )  # fmt: skip
    parser.add_argument(
        "--rflysim", type=int, metavar="PORT", help="UDP port for RflySim's fault packets"
    )
    parser.add_argument(
        "--rflysim-map", metavar="YAML", help="map of its fault ids (default: built-in)"
    )
    _add_signing(parser)
    parser.set_defaults(main=_proxy)


def _add_signing(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--signing-key", metavar="FILE", help="passphrase to verify and sign frames with"
    )
    parser.add_argument("--strip-signatures", action="store_true", help="send frames unsigned")


def _proxy(args: argparse.Namespace) -> int:
    # Loaded modules stay; scanning them for garbage takes a tenth of the start-up time.
    gc.disable()
    try:
        return main_of("mavproxy_fault.app.proxy_command")(args)
    finally:
        gc.enable()


def add_replay(commands: Any) -> None:
    """`replay`: run a log through the proxy."""
    parser = commands.add_parser("replay", help="replay a tlog, or apply faults to a RINEX file")
    parser.add_argument("log", metavar="LOG", help="a tlog, or a RINEX observation file")
    parser.add_argument(
        "--schedule", metavar="YAML", help="faults to apply (default: those of the recording)"
    )
    parser.add_argument(
        "--nav", nargs="+", metavar="FILE", help="RINEX navigation files, for spoofs into RINEX"
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--out", metavar="LOG", help="write the sent tlog, with the labels beside it"
    )
    where.add_argument("--link", metavar="EP", help=f"send in real time: {ENDPOINT}")
    _add_signing(parser)
    add_json(parser)
    parser.set_defaults(main=main_of("mavproxy_fault.app.replaying.replay"))


def add_inject(commands: Any) -> None:
    """`inject`: set, change or clear a live fault on a running proxy."""
    parser = commands.add_parser("inject", help="set, change or clear a fault on a running proxy")
    parser.add_argument("fault", nargs="?", metavar="FAULT", help="fault or preset by name")
    parser.add_argument("--target", metavar="MSG.FIELD", help="what the fault acts on")
    parser.add_argument("--value", type=float, metavar="X", help="magnitude in the field's unit")
    parser.add_argument(
        "--for", dest="for_s", type=float, metavar="S", help="end after S seconds (default: never)"
    )
    parser.add_argument("--id", metavar="ID", help="the fault's id (default: its name)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="another key of the schedule entry, such as probability=0.2; repeatable",
    )  # fmt: skip
    parser.add_argument("--clear", metavar="ID", help="end this fault (its id, or 'all')")
    parser.add_argument("--list", action="store_true", help="list the faults of the proxy")
    parser.add_argument(
        "--through", choices=["mavsdk"],
        help="send MAV_CMD_INJECT_FAILURE instead; FAULT is UNIT:TYPE[:INSTANCE]",
    )  # fmt: skip
    parser.add_argument(
        "--link", metavar="URL",
        help="where --through finds the vehicle (default: udpin://127.0.0.1:14540)",
    )  # fmt: skip
    _add_run(parser)
    add_json(parser)
    parser.set_defaults(main=_inject)


def add_bus(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options of a command that publishes on Zenoh."""
    parser.add_argument(
        "--zenoh", default="auto", metavar="auto|off|URL",
        help=f"{what} on Zenoh (default: auto, tcp/127.0.0.1:7447)",
    )  # fmt: skip
    _add_bus_config(parser)


def add_router(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that connects to a Zenoh router."""
    parser.add_argument(
        "--zenoh", default="auto", metavar="auto|URL",
        help="the proxy's router (default: auto, tcp/127.0.0.1:7447)",
    )  # fmt: skip
    _add_bus_config(parser)


def _add_bus_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--zenoh-config", default="", metavar="FILE",
        help="Zenoh configuration: TLS, users, access (default: $ZENOH_CONFIG, or this user only)",
    )  # fmt: skip


def _add_run(parser: argparse.ArgumentParser) -> None:
    """Add the options that select a running proxy."""
    parser.add_argument("--run", metavar="NAME", help="proxy or run (default: the only one)")
    add_router(parser)


def _inject(args: argparse.Namespace) -> int:
    module = "inject" if args.through is None else "standard_failure"
    return main_of(f"mavproxy_fault.app.{module}")(args)


def add_schedule(commands: Any) -> None:
    """`schedule`: load, save, show or clear the schedule of a running proxy."""
    parser = commands.add_parser("schedule", help="load, save, show or clear a running schedule")
    actions = parser.add_subparsers(dest="action", title="actions", metavar="ACTION", required=True)
    load = actions.add_parser("load", help="replace the running schedule by a file")
    load.add_argument("file", metavar="YAML", help="its times count from now on")
    save = actions.add_parser("save", help="write the running schedule, live faults included")
    save.add_argument("file", nargs="?", metavar="YAML", help="(default: to the terminal)")
    state = actions.add_parser("state", help="state of all faults, as JSON")
    clear = actions.add_parser("clear", help="end every fault")
    for action in (load, save, state, clear):
        _add_run(action)
    add_json(load, save, state, clear)
    parser.set_defaults(main=main_of("mavproxy_fault.app.schedule_command"))


def add_faults(commands: Any) -> None:
    """`faults`: list faults and presets, check and plot schedules."""
    parser = commands.add_parser("faults", help="list faults and presets; check and plot schedules")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list all faults and presets, or all messages")
    listing.add_argument("--messages", action="store_true", help="list the known messages")
    listing.set_defaults(action="list")
    show = actions.add_parser("show", help="show parameters and an example of a fault or preset")
    show.add_argument("name", metavar="FAULT", help="fault or preset by name")
    show.set_defaults(action="show")
    check = actions.add_parser("check", help="check a schedule file")
    check.add_argument("file", metavar="YAML", help="the schedule")
    check.set_defaults(action="check")
    plot = actions.add_parser("plot", help="draw a schedule's fault functions to PNG")
    plot.add_argument("file", metavar="YAML", help="the schedule, or a preset by name")
    plot.add_argument("--out", metavar="PNG", help="(default: name of the schedule with .png)")
    plot.set_defaults(action="plot")
    add_json(listing, show, check, plot)
    actions.add_parser("schema", help="JSON Schema of schedules").set_defaults(action="schema")
    parser.set_defaults(main=main_of("mavproxy_fault.app.catalogue"))


def add_ardupilot(commands: Any) -> None:
    """`ardupilot`: the bridge between ArduPilot and a HIL simulator."""
    parser = commands.add_parser("ardupilot", help="connect ArduPilot to a HIL simulator for PX4")
    parser.add_argument(
        "--hil", default="tcp:127.0.0.1:4560", metavar="EP", help="simulator or proxy (4560)"
    )
    parser.add_argument("--binary", metavar="PATH", help="SITL executable, with options")
    parser.add_argument(
        "--vectornav", metavar="EP", help="or: the connection to a board's external AHRS port"
    )
    parser.add_argument("--mavlink", metavar="EP", help="and the connection to its MAVLink port")
    parser.add_argument(
        "--vehicle", choices=("copter", "plane"), default="copter", help="vehicle type"
    )
    parser.add_argument(
        "--parameters", metavar="FILE", help="parameter file, applied after the bridge's own"
    )
    parser.add_argument(
        "--out", default="ardupilot", metavar="DIR", help="working folder of ArduPilot"
    )
    parser.set_defaults(main=main_of("mavproxy_fault.ardupilot.bridge_command"))


def add_new(commands: Any) -> None:
    """`new`: a package of one's own."""
    parser = commands.add_parser("new", help="write a package with an estimator, detector or fault")
    parser.add_argument("kind", choices=("estimator", "detector", "fault"), help="what it adds")
    parser.add_argument("name", metavar="NAME", help="its name, such as gyro-only")
    parser.add_argument("--out", metavar="DIR", help="its folder (default: NAME)")
    add_json(parser)
    parser.set_defaults(main=main_of("mavproxy_fault.app.new_package"))


BUILT_IN_COMMANDS: dict[str, AddCommand] = {
    "ardupilot": add_ardupilot,
    "proxy": add_proxy,
    "replay": add_replay,
    "inject": add_inject,
    "schedule": add_schedule,
    "faults": add_faults,
    "new": add_new,
}
