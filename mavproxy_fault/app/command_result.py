"""A command's result: text for people, or with `--json` one line for programs."""

import argparse
import sys
from collections.abc import Callable, Container
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

LOG_WIDTH = 1000  # chosen: longer than any row, so that no table is cut in a file or a CI log


def print_result(args: argparse.Namespace, data: object, show: str | Callable[[], None]) -> None:
    """Print a result as JSON if the command line asks for it, otherwise the text or by `show`."""
    if getattr(args, "json", False):
        import msgspec  # here: the proxy starts without it

        print(msgspec.json.encode(data, enc_hook=str).decode())  # the paths of files
    elif callable(show):
        show()
    else:
        print(show)


def open_console() -> "Console":
    """Open the terminal for text and tables, as wide as it is; a file or a pipe has no width."""
    from rich.console import Console

    # Texts of users and autopilots may contain brackets.
    width = None if sys.stdout.isatty() else LOG_WIDTH
    return Console(markup=False, highlight=False, width=width)


def plain_table(*columns: str, right: Container[str] = ()) -> "Table":
    """Make a table without lines, whose long words are folded, not cut."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in columns:
        table.add_column(name, justify="right" if name in right else "left", overflow="fold")
    return table
