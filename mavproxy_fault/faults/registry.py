"""All faults by name; other packages add theirs by entry point (group `mavproxy_fault.faults`)."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any

from mavproxy_fault.faults import driven, freeze, loss, noise, timing

OURS: dict[str, type] = {
    "bias": driven.Bias,
    "constant": driven.Constant,
    "delay": timing.Delay,
    "drift": driven.Drift,
    "drop": loss.Drop,
    "freeze": freeze.Freeze,
    "noise": noise.Noise,
    "random-walk": noise.RandomWalk,
    "scale": driven.Scale,
}
ALIASES = {"stuck": "freeze", "ramp": "drift"}


@cache
def known_faults() -> dict[str, type[Any]]:
    """Name to class, sorted by name; aliases are left out."""
    found = dict(OURS)
    for point in entry_points(group="mavproxy_fault.faults"):
        found[point.name] = point.load()
    return dict(sorted(found.items()))


def fault_class(name: str) -> type[Any] | None:
    """The class of a fault by its name or alias; None if there is none."""
    return known_faults().get(ALIASES.get(name, name))
