"""The `mavproxy-fault` command: the built-in subcommands and those of other packages.

Other packages register a subcommand by entry point (group `mavproxy_fault.commands`): a function
that adds its parser to the given subparsers and sets the default `main`, a function of the parsed
arguments that returns the exit code. Heavy imports belong inside `main`.
"""

import argparse
import errno
import logging
import os
import sys
from _thread import interrupt_main
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import invalidate_caches
from importlib.util import find_spec
from io import TextIOWrapper
from pathlib import Path
from signal import SIG_IGN, SIGINT, SIGTERM, default_int_handler, getsignal, signal
from threading import Timer, current_thread, main_thread
from typing import Any

from mavproxy_fault import __version__
from mavproxy_fault.app.command_parser import CommandParser, CompletionAction
from mavproxy_fault.app.commands import BUILT_IN_COMMANDS, AddCommand
from mavproxy_fault.app.lossy_log import LossyHandler
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.wire.dialect_files import DIALECT_VARIABLE, dialect_paths, find_recorded

EPILOG = """\
examples
  mavproxy-fault run                   the built-in demo, report in runs/
  mavproxy-fault proxy --master udpin:127.0.0.1:14560 \\
                       --to udpout:127.0.0.1:14550 --schedule gyro_bias.yaml
  mavproxy-fault report flight.tlog    any tlog, ULog or dataflash log

connection strings (as in pymavlink)
  udpin:HOST:PORT   listen          udpout:HOST:PORT  send to
  tcp:HOST:PORT     TCP client      tcpin:HOST:PORT   TCP server
  /dev/ttyACM0,57600                serial device and baud rate

options that mean the same in every command
  --out     the output: a folder, or one file for `replay` and `faults plot`
  --link    the connection to monitor, replay to or send through
  --run     the name of a proxy on Zenoh; --zenoh is its router

completion
  eval "$(mavproxy-fault --completion bash)"    a line for ~/.bashrc

default ports (all on 127.0.0.1)
  4560 TCP  PX4's HIL link          14550 UDP  ground station
  7447 TCP  Zenoh router            8350 TCP   the page (ui)

exit codes
  0 success    1 the verdict is FAIL    2 the input is invalid

`help COMMAND` explains a command; --json prints its result for programs.
NO_COLOR turns colours off.
"""
INTERRUPT_AGAIN_S = 0.01  # by then a destructor has returned
RECORDING_READERS = ("replay", "report", "monitor")  # they know a session's own dialects
SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")  # supported by shtab
HELP_ORDER = (
    "run", "sim", "proxy", "monitor", "replay", "inject", "schedule", "faults", "campaign",
    "search", "report", "ui", "new", "warm-up",
)  # fmt: skip


def build_parser(command: str = "") -> argparse.ArgumentParser:
    """Build the parser with all subcommands, or only the built-in ones if `command` is one.

    Raises
    ------
    ConfigError
        If `command` does not exist.
    """
    top = CommandParser(
        prog="mavproxy-fault",
        description="Apply sensor and link faults to MAVLink traffic and assess the response.",
        epilog=EPILOG,
    )
    top.add_argument(
        "--dialect", action="append", default=[], metavar="FILE",
        help="additional MAVLink dialect (XML file); every command takes it, repeatable",
    )  # fmt: skip
    top.add_argument("--version", action="version", version=f"mavproxy-fault {__version__}")
    top.add_argument(
        "--completion", action=CompletionAction, metavar="SHELL", choices=SHELLS,
        help=f"print the completion script for {', '.join(SHELLS)} (default: none)",
    )  # fmt: skip
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    # The search for plugins takes longer than the start of a built-in command.
    adders = (
        BUILT_IN_COMMANDS
        if command in BUILT_IN_COMMANDS
        else {**_registered(), **BUILT_IN_COMMANDS}
    )
    if command and not command.startswith("-") and command not in adders:
        known = suggest_known(command, [*adders, "help"])
        raise ConfigError(f"{command}: is not a command; {known}")
    # The help lists our commands in a fixed order and then the plugins by name.
    for name in [*(n for n in HELP_ORDER if n in adders), *sorted(adders.keys() - set(HELP_ORDER))]:
        adders[name](commands)
    return top


def _registered() -> dict[str, AddCommand]:
    """Return the subcommands of other packages by name; the search is slow."""
    from importlib.metadata import entry_points

    return {point.name: point.load() for point in entry_points(group="mavproxy_fault.commands")}


def _prefer_own_packages() -> None:
    """Make `analysis` and `simvehicle` mean ours, also in a folder that has such a file or package.

    Raises
    ------
    ConfigError
        If another package of that name has been imported already.
    """
    root = Path(__file__).resolve().parents[1]
    for name in ("analysis", "simvehicle"):
        # The search finds a module that is loaded without looking at the path.
        found = find_spec(name)
        if (
            found is None
            or found.origin is None
            or root not in Path(found.origin).resolve().parents
        ):
            if name in sys.modules:
                raise ConfigError(
                    f"{name}: another package of this name has been imported, and ours cannot be "
                    "beside it; start mavproxy-fault as a process of its own"
                )
            # In front of the working directory and of PYTHONPATH.
            sys.path.insert(0, str(root))
            invalidate_caches()


@contextmanager
def _handle_signals(last: bool) -> Iterator[None]:
    """Make SIGTERM and SIGINT end a command as Ctrl-C does.

    A shell starts background jobs (`&`) with SIGINT ignored; we handle it even then. Once the
    `last` command of a process has finished, a signal no longer changes its exit code.
    """
    if current_thread() is not main_thread():  # only the main thread may set handlers
        yield
        return
    before = {number: getsignal(number) for number in (SIGINT, SIGTERM)}
    for number in before:
        signal(number, default_int_handler)
    after = dict.fromkeys(before, SIG_IGN) if last else before
    hook = sys.unraisablehook
    sys.unraisablehook = partial(_interrupt_again, hook)
    try:
        yield
    except BaseException:
        after = before  # a failure that hangs during clean-up must stay interruptible
        raise
    finally:
        sys.unraisablehook = hook
        for number, action in after.items():
            signal(number, action)


def _interrupt_again(hook: Callable[[Any], object], unraisable: Any) -> None:
    """Repeat a KeyboardInterrupt that Python ignores in a destructor or a weak reference's
    callback: the command would go on."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        Timer(INTERRUPT_AGAIN_S, interrupt_main).start()
    else:
        hook(unraisable)


def _take_dialects(given: Sequence[str]) -> list[str]:
    """Remove `--dialect FILE`, which every command accepts, and set its variable."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--dialect", action="append", default=[])
    try:
        known, rest = parser.parse_known_args(given)
    except SystemExit:
        raise ConfigError("--dialect: has no value; give a MAVLink XML file") from None
    # Absolute, since a command may change its folder.
    files = [os.path.abspath(name) for name in (*dialect_paths(), *known.dialect)]
    if rest and rest[0] in RECORDING_READERS:
        files += find_recorded(rest[1:], files)
    os.environ[DIALECT_VARIABLE] = os.pathsep.join(files)
    return rest


def _reopen_closed_streams() -> None:
    """Reopen streams that the shell closed (`>&-`), or a socket would get their descriptors."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115


def _drop_output() -> None:
    """Discard output that could not be written, or Python would complain at exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError):  # a test may have replaced the stream
        os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return the exit code."""
    _reopen_closed_streams()
    for stream in (
        sys.stdout,
        sys.stderr,
    ):  # the terminal's encoding may lack characters of the user's file names
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.lastResort = LossyHandler()
    given = sys.argv[1:] if arguments is None else arguments
    try:
        _prefer_own_packages()
        given = _take_dialects(given)
        if given[:1] == ["help"]:
            given = [*given[1:], "--help"]
        parsed = build_parser(given[0] if given else "").parse_args(given)
        # Commands return their exit code; any exception but a ConfigError is a bug and shown.
        with _handle_signals(last=arguments is None):
            code: int = parsed.main(parsed)
    except ConfigError as error:
        print(f"mavproxy-fault: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        # 128 + SIGINT, as shells count.
        return 130
    except BrokenPipeError:
        # The reader has closed the pipe, as `head` does: Python would complain at exit.
        sys.stderr.close()
        return 0
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            print(f"mavproxy-fault: {error.strerror}; raise the limit (ulimit -n)", file=sys.stderr)
            return 2
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        print(f"mavproxy-fault: {error.strerror}; the output is incomplete", file=sys.stderr)
        _drop_output()
        return 2
    return code


if __name__ == "__main__":
    sys.exit(main())
