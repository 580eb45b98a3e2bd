"""All faults by name: every class with a `name` in the files of this folder, and others' plugins.

Other packages add theirs by entry point (group `mavproxy_fault.faults`); ours win over plugins of
the same name.
"""

import pkgutil
from functools import cache
from importlib import import_module
from typing import Any

from mavproxy_fault import faults


@cache
def our_faults() -> dict[str, type[Any]]:
    """Name to class of the faults in this folder."""
    found: dict[str, type[Any]] = {}
    for file in pkgutil.iter_modules(faults.__path__):
        module = import_module(f"{faults.__name__}.{file.name}")
        for kind in vars(module).values():
            # Classes that a file only imports belong to another file.
            own = isinstance(kind, type) and kind.__module__ == module.__name__
            if own and isinstance(vars(kind).get("name"), str):
                found[kind.name] = kind
    return found


@cache
def known_faults() -> dict[str, type[Any]]:
    """Name to class, sorted by name; aliases are left out."""
    from importlib.metadata import entry_points  # a twentieth of a second, for what few have

    plugins = {point.name: point.load() for point in entry_points(group="mavproxy_fault.faults")}
    return dict(sorted({**plugins, **our_faults()}.items()))


@cache
def known_aliases() -> dict[str, str]:
    """Further name to name."""
    kinds = known_faults().items()
    return {alias: name for name, kind in kinds for alias in getattr(kind, "aliases", ())}


def fault_class(name: str) -> type[Any] | None:
    """The class of a fault by its name or alias; None if there is none."""
    found = our_faults().get(name)
    # Ours need no search for plugins, which takes longer than all the rest.
    return found or known_faults().get(known_aliases().get(name, name))


def acts_on_ranges(kind: type[Any]) -> bool:
    """Whether a fault takes PSEUDORANGE targets."""
    return bool(getattr(kind, "on_ranges", False))
