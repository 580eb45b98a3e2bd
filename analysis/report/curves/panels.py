"""The plots of a report in order: section, title and unit, by the table `panels.txt`."""

import re
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot over time; signals refer to it by `key`; `log` means a logarithmic axis.

    It is shown if it has at least `least` curves.
    """

    key: str
    section: str
    title: str
    unit: str
    log: bool = False
    least: int = 1


TIMELINE = "Timeline"
CHECKS = "Checks"
DETECTION = "Fault detection"
FUSION = "Fused solution"
FAULT_EFFECTS = "Effects of the faults"
ATTITUDE = "Attitude"
GPS = "GPS"
SYSTEM = "System"
LINK = "Link quality"
SPECTRA = "Spectra"
FIELDS = "Any field"


def _read_panels(text: str) -> tuple[Panel, ...]:
    found, section = [], ""
    for line in text.splitlines():
        if line.startswith("  "):
            key, title, unit, *more = re.split(" {2,}", line.strip())
            least = next((int(word) for word in more if word.isdigit()), 1)
            shown = "" if unit == "-" else unit
            found.append(Panel(key, section, title, shown, "log" in more, least))
        elif not line.startswith("#"):
            section = line
    return tuple(found)


PANELS = _read_panels((files(__package__) / "panels.txt").read_text(encoding="utf-8"))
BY_KEY = {panel.key: panel for panel in PANELS}
