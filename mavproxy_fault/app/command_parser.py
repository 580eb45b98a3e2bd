"""The parser of every command: its help tells all defaults, its refusals what was meant."""

import argparse
import itertools
import re
from collections.abc import Iterable
from typing import Any

from mavproxy_fault.documents.suggestion import suggest_known


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help in which every option that takes a value tells its default."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        text = action.help or ""
        # Flags are off by default, and a default that is found at the start is told in words.
        if not action.option_strings or action.nargs == 0 or action.required or "default" in text:
            return action.help
        return f"{text} (default: {'none' if action.default in (None, []) else '%(default)s'})"


class CommandParser(argparse.ArgumentParser):
    """A parser whose subparsers, those of other packages too, are of its own kind."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **{"formatter_class": _Help, **keys})

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; an option that is none is refused before what is missing besides."""
        # A parser with subcommands sees their options too: its own stand before the first word.
        ours = "--".__ne__ if self._subparsers is None else re.compile("--.").match
        for word in itertools.takewhile(ours, args or ()):
            self._check_option(word.partition("=")[0])
        return super().parse_known_args(args, namespace)

    def _check_option(self, word: str) -> None:
        known = self._option_string_actions
        # Options may be cut short.
        if word.startswith("--") and not any(name.startswith(word) for name in known):
            # Without the hyphens, which make all of them alike.
            names = [name[2:] for name in known if name.startswith("--")]
            self.error(f"there is no option {word}; {suggest_known(word[2:], names)}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        # Python does so itself from 3.14 on.
        choices: Iterable[Any] | None = action.choices
        if choices is not None and value not in choices:
            known = suggest_known(str(value), map(str, choices))
            raise argparse.ArgumentError(action, f"there is no {value}; {known}")


class CompletionAction(argparse.Action):
    """`--completion SHELL`: what makes that shell complete commands, options and files."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        import shtab

        _complete_files(parser, shtab.FILE, shtab.DIRECTORY)
        print(shtab.complete(parser, values))
        parser.exit()


def _complete_files(parser: argparse.ArgumentParser, file: Any, folder: Any) -> None:
    """Let shtab complete what stands for a file or a folder, in every subcommand."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                _complete_files(sub, file, folder)
        elif action.metavar == "DIR":
            action.complete = folder  # type: ignore[attr-defined]  # shtab looks for it here
        elif action.metavar in ("FILE", "LOG", "PNG", "CSV", "SCENARIO", "TESTFILE", "PATH"):
            action.complete = file  # type: ignore[attr-defined]
