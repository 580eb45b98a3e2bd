"""All faults by name: every class with a `name` in the files of this folder, and plugins.

Other packages register faults by entry point (group `mavproxy_fault.faults`); a built-in fault
takes precedence over a plugin of the same name.
"""

import pkgutil
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

from mavproxy_fault import faults
from mavproxy_fault.fault_parts.rules import Rule


@cache
def our_faults() -> dict[str, type[Any]]:
    """Return the classes of the built-in faults by name."""
    found: dict[str, type[Any]] = {}
    for file in pkgutil.iter_modules(faults.__path__):
        module = import_module(f"{faults.__name__}.{file.name}")
        for kind in vars(module).values():
            # Skip classes that the file imports from another.
            own = isinstance(kind, type) and kind.__module__ == module.__name__
            if own and isinstance(vars(kind).get("name"), str):
                found[kind.name] = kind
    return found


def numbered_rules(rules: Sequence[Rule]) -> list[Rule]:
    """Return all `VALUE_RULES` or `LINK_RULES` in the order of their names: compiled code calls
    them by their place, whatever was imported first."""
    our_faults()
    return sorted(rules, key=lambda rule: f"{rule.__module__}.{rule.__name__}")


@cache
def known_faults() -> dict[str, type[Any]]:
    """Return the classes of all faults, sorted by name, without aliases."""
    from importlib.metadata import entry_points  # imported late, since it takes 0.05 s

    plugins = {point.name: point.load() for point in entry_points(group="mavproxy_fault.faults")}
    return dict(sorted({**plugins, **our_faults()}.items()))


@cache
def known_aliases() -> dict[str, str]:
    """Return the name of the fault for each alias."""
    kinds = known_faults().items()
    return {alias: name for name, kind in kinds for alias in getattr(kind, "aliases", ())}


def fault_class(name: str) -> type[Any] | None:
    """Return the class of a fault by name or alias; None if there is none."""
    found = our_faults().get(name)
    # Built-in faults first, since the search for plugins is slow.
    return found or known_faults().get(known_aliases().get(name, name))


def acts_on_ranges(kind: type[Any]) -> bool:
    """Whether a fault accepts PSEUDORANGE targets."""
    return bool(getattr(kind, "on_ranges", False))
