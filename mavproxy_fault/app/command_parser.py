"""The argument parser of all commands: help with defaults, errors with suggestions."""

import argparse
import itertools
import re
from collections.abc import Iterable
from importlib import import_module
from typing import Any, NoReturn

from mavproxy_fault.documents.suggestion import suggest_known


class _Help(argparse.RawDescriptionHelpFormatter):
    """Adds the default to the help of every option with a value."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        text = action.help or ""
        # Flags are off by default; a help text may state its default itself.
        if not action.option_strings or action.nargs == 0 or action.required or "default" in text:
            return action.help
        return f"{text} (default: {'none' if action.default in (None, []) else '%(default)s'})"


def positive_count(text: str) -> int:
    """Parse the argument of an option that counts something.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is no whole number of 1 or more.
    """
    if not (text.isascii() and text.isdigit() and int(text)):
        raise argparse.ArgumentTypeError(f"{text} is no whole number of 1 or more")
    return int(text)


def add_option(parser: Any, written: str, help: str, **keys: Any) -> Any:
    """Add an option to a parser or a group and return its action.

    Parameters
    ----------
    written : str
        As the usage writes it: `--to EP...` is repeatable, `--busy-poll` a flag, and
        `--out --logdir DIR` one option with two names. With `choices` it has no metavar.
    """
    names = [word for word in written.split() if word.startswith("--")]
    metavar = written.split()[len(names) :]
    if metavar:
        keys["metavar"] = metavar[0].removesuffix("...")
        if metavar[0].endswith("..."):
            keys |= {"action": "append", "default": []}
            help += "; repeatable" * ("repeatable" not in help)
    elif "choices" not in keys:
        keys.setdefault("action", "store_true")
    return parser.add_argument(*names, help=help, **keys)


def add_json(*parsers: argparse.ArgumentParser) -> None:
    """Add the option `--json` of commands that print a result."""
    for parser in parsers:
        add_option(parser, "--json", "print the result as JSON")


class CommandParser(argparse.ArgumentParser):
    """A parser that suggests corrections; its subparsers, also of plugins, are of this class."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **{"formatter_class": _Help, **keys})

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an unknown option is reported before missing arguments."""
        # The options of a parser with subcommands end at the first positional argument.
        is_own = "--".__ne__ if self._subparsers is None else re.compile("--.").match
        if args == [] and self._subparsers is not None:
            self.print_help()
            self.exit(2)  # nothing was done
        given: set[str] = set()
        for argument in itertools.takewhile(is_own, args or ()):
            self._check_option(argument.partition("=")[0])
            self._check_repetition(argument.partition("=")[0], given)
        return super().parse_known_args(args, namespace)

    def _check_option(self, argument: str) -> None:
        known = self._option_string_actions
        # Options may be abbreviated.
        if argument.startswith("--") and not any(name.startswith(argument) for name in known):
            # Without the hyphens, which would make all names similar.
            names = [name[2:] for name in known if name.startswith("--")]
            known_names = suggest_known(argument[2:], names, "--")
            self.error(f"option {argument} does not exist; {known_names}")

    def _check_repetition(self, argument: str, given: set[str]) -> None:
        """Refuse an option that would replace its earlier value; note it in `given`."""
        known = self._option_string_actions
        names = [name for name in known if argument.startswith("--") and name.startswith(argument)]
        action = known.get(argument) or (known[names[0]] if len(names) == 1 else None)
        # An option with a value that does not collect values.
        if not isinstance(action, argparse._StoreAction):
            return
        if action.dest in given:
            self.error(f"option {action.option_strings[0]} is given twice; give it once")
        given.add(action.dest)

    def error(self, message: str) -> NoReturn:
        """Exit with an error as other errors are, and where the help is instead of the usage."""
        text = message.removeprefix("argument ")
        self.exit(2, f"{self.prog}: {text}\n(`{self.prog} --help` explains it)\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        # Python 3.14 and later suggest choices themselves.
        choices: Iterable[Any] | None = action.choices
        if choices is not None and value not in choices:
            known = suggest_known(str(value), map(str, choices))
            raise argparse.ArgumentError(action, f"{value} does not exist; {known}")


class CompletionAction(argparse.Action):
    """`--completion SHELL`: print the shell's completion script."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        import shtab

        _complete_arguments(parser)
        print(shtab.complete(parser, values))
        parser.exit()


# Names by metavar: the registry of a package that an entry point may extend.
KNOWN_NAMES = {
    "FAULT": ("mavproxy_fault.app.catalogue", "fault_and_preset_names"),
    "MSG.FIELD": ("mavproxy_fault.wire.dialect", "message_names"),
    "ESTIMATORS": ("analysis.estimators", "estimator_names"),
    "REQUIREMENT": ("analysis.scoring.requirements", "ready_requirements"),
    "FORMULA|NAME": ("analysis.scoring.requirements", "ready_requirements"),
}
YAML_FILES = ("*.yaml", "*.yml")
FILE_PATTERNS = {
    "YAML": YAML_FILES, "SCENARIO": YAML_FILES, "TESTFILE": YAML_FILES, "PNG": ("*.png",),
    "CSV": ("*.csv",), "LOG": ("*.tlog", "*.ulg", "*.bin", "*.log", "*.BIN", "*.??o", "*.rnx"),
}  # fmt: skip


def _complete_arguments(parser: argparse.ArgumentParser) -> None:
    """Make shtab complete the names, files and folders of all subcommands, by their metavars."""
    import shtab

    for action in parser._actions:
        kind = str(action.metavar)
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _complete_arguments(sub)
        elif kind in KNOWN_NAMES:
            module, function = KNOWN_NAMES[kind]
            action.choices = list(getattr(import_module(module), function)())
        elif kind in FILE_PATTERNS:
            action.complete = shtab.glob(*FILE_PATTERNS[kind])  # type: ignore[attr-defined]
        elif kind in ("FILE", "PATH", "POINT|FILE"):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif kind == "DIR":
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
