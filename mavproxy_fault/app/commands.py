"""The parsers of the proxy's subcommands, whose modules are imported when they run."""

import argparse
import gc
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from mavproxy_fault.app.command_parser import add_json, add_option

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
    option = partial(add_option, parser)
    option("--master EP", f"the vehicle: {ENDPOINT}", required=True)
    to = option("--to EP...", "ground station, autopilot ...", required=True)
    # MAVProxy's name, accepted but not shown: in our other commands it is the output.
    parser._option_string_actions["--out"] = to
    option("--schedule YAML", "faults to apply")
    option("--logdir DIR", "write tlogs and labels here")
    option("--allow-peer NET...", "address or network for udpin; repeatable (default: any)")
    option("--lock-peer", "restrict each udpin to the first peer that sends a valid frame")
    option("--busy-poll", "busy-wait for lowest latency")
    add_bus(parser, "control and statistics")
    option("--run NAME", "this proxy's name on Zenoh (default: live)")
    files = "allow requests to read series files from this folder; repeatable (default: none)"
    option("--files DIR...", files)
    option("--no-inject", "refuse live faults", dest="inject", action="store_false")
    commanding = "allow schedules and live control to arm, fly and land the vehicle"
    option("--allow-commands", commanding)
    option("--rflysim PORT", "UDP port for RflySim's fault packets", type=int)
    option("--rflysim-map YAML", "map of its fault ids (default: built-in)")
    _add_signing(parser)
    add_json(parser)
    parser.set_defaults(main=_proxy)


def _add_signing(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--signing-key FILE", "passphrase to verify and sign frames with")
    add_option(parser, "--strip-signatures", "send frames unsigned")


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
    option = partial(add_option, parser)
    option("--schedule YAML", "faults to apply (default: those of the recording)")
    option("--nav FILE", "RINEX navigation files, for spoofs into RINEX", nargs="+")
    where = parser.add_mutually_exclusive_group(required=True)
    add_option(where, "--out LOG", "write the sent tlog, with the labels beside it")
    add_option(where, "--link EP", f"send in real time: {ENDPOINT}")
    _add_signing(parser)
    add_json(parser)
    parser.set_defaults(main=main_of("mavproxy_fault.app.replaying.replay"))


def add_inject(commands: Any) -> None:
    """`inject`: set, change or clear a live fault on a running proxy."""
    parser = commands.add_parser("inject", help="set, change or clear a fault on a running proxy")
    parser.add_argument("fault", nargs="?", metavar="FAULT", help="fault or preset by name")
    option = partial(add_option, parser)
    option("--target MSG.FIELD", "what the fault acts on")
    option("--value X", "magnitude in the field's unit", type=float)
    option("--for S", "end after S seconds (default: never)", dest="for_s", type=float)
    option("--id ID", "the fault's id (default: its name)")
    option("--set KEY=VALUE...", "another key of the schedule entry, such as probability=0.2")
    option("--clear ID", "end this fault (its id, or 'all')")
    option("--list", "list the faults of the proxy")
    through = "send MAV_CMD_INJECT_FAILURE instead; FAULT is UNIT:TYPE[:INSTANCE]"
    option("--through", through, choices=["mavsdk"])
    option("--link URL", "where --through finds the vehicle (default: udpin://127.0.0.1:14540)")
    _add_run(parser)
    add_json(parser)
    parser.set_defaults(main=_inject)


def add_bus(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options of a command that publishes on Zenoh."""
    help = f"{what} on Zenoh (default: auto, tcp/127.0.0.1:7447)"
    _add_zenoh(parser, "--zenoh auto|off|URL", help)


def add_router(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that connects to a Zenoh router."""
    help = "Zenoh router of the proxy (default: auto, which is tcp/127.0.0.1:7447)"
    _add_zenoh(parser, "--zenoh auto|URL", help)


def _add_zenoh(parser: argparse.ArgumentParser, written: str, help: str) -> None:
    add_option(parser, written, help, default="auto")
    file = "Zenoh configuration: TLS, users, access (default: $ZENOH_CONFIG, or this user only)"
    add_option(parser, "--zenoh-config FILE", file, default="")


def _add_run(parser: argparse.ArgumentParser) -> None:
    """Add the options that select a running proxy."""
    add_option(parser, "--run NAME", "proxy or run (default: the only one)")
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
    add_option(listing, "--messages", "list the known messages")
    listing.set_defaults(action="list")
    show = actions.add_parser("show", help="show parameters and an example of a fault or preset")
    show.add_argument("name", metavar="FAULT", help="fault or preset by name")
    show.set_defaults(action="show")
    check = actions.add_parser("check", help="check a schedule file")
    check.add_argument("file", metavar="YAML", help="the schedule")
    check.set_defaults(action="check")
    plot = actions.add_parser("plot", help="draw a schedule's fault functions to PNG")
    plot.add_argument("file", metavar="YAML", help="the schedule, or a preset by name")
    add_option(plot, "--out PNG", "(default: name of the schedule with .png)")
    plot.set_defaults(action="plot")
    add_json(listing, show, check, plot)
    actions.add_parser("schema", help="JSON Schema of schedules").set_defaults(action="schema")
    parser.set_defaults(main=main_of("mavproxy_fault.app.catalogue"))


def add_ardupilot(commands: Any) -> None:
    """`ardupilot`: the bridge between ArduPilot and a HIL simulator."""
    parser = commands.add_parser("ardupilot", help="connect ArduPilot to a HIL simulator for PX4")
    option = partial(add_option, parser)
    option("--hil EP", "simulator or proxy (4560)", default="tcp:127.0.0.1:4560")
    option("--binary PATH", "SITL executable, with options")
    option("--vectornav EP", "or: the connection to a board's external AHRS port")
    option("--mavlink EP", "and the connection to its MAVLink port")
    option("--vehicle", "vehicle type", choices=("copter", "plane"), default="copter")
    option("--parameters FILE", "parameter file, applied after the bridge's own")
    option("--out DIR", "working folder of ArduPilot", default="ardupilot")
    parser.set_defaults(main=main_of("mavproxy_fault.ardupilot.bridge_command"))


def add_new(commands: Any) -> None:
    """`new`: a package of one's own."""
    parser = commands.add_parser("new", help="write a package with an estimator, detector or fault")
    parser.add_argument("kind", choices=("estimator", "detector", "fault"), help="what it adds")
    parser.add_argument("name", metavar="NAME", help="its name, such as gyro-only")
    add_option(parser, "--out DIR", "its folder (default: NAME)")
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
