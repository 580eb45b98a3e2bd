"""Content of an observation file's header records, at the file's start or in an event.

A record applies from its position in the file until another replaces it [1]_.

References
----------
.. [1] IGS/RTCM, RINEX 3.05 and 4.01, tables A2, A3; W. Gurtner, RINEX 2.11, tables A1, A2.
"""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import msgspec

FIELD = 16  # width of an observation: F14.3, loss of lock, signal strength
NAME = 3  # a line of RINEX 3 begins with the satellite's name
PER_LINE_2, MOST_TYPES = 5, 1000  # observations in a line of RINEX 2, and of RINEX 3
# The time system of a file of one satellite system that does not name another.
OWN_CLOCK = {"R": "GLO", "E": "GAL", "C": "BDT", "J": "QZS"}


class ObservationField(NamedTuple):
    """One field of a satellite: its type (`C1C`, or `C1` in RINEX 2), line and column, and the
    factor of the stored number."""

    name: str
    at: int
    column: int
    scale: float = 1.0

    @property
    def signal(self) -> str:
        """The part of the type that all observations of one signal share."""
        return self.name[1:]


class ObservationHeader(msgspec.Struct, frozen=True, eq=False):
    """The header records that hold at a place in the file.

    `types` are the observation types by system (RINEX 2: of all systems, ""), `scales` the factors
    of those that are stored multiplied, `channels` the frequency channels of GLONASS satellites.
    """

    version: float = 3.0
    system: str = "M"
    time_system: str = ""
    types: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    scales: Mapping[tuple[str, str], float] = MappingProxyType({})
    channels: Mapping[str, int] = MappingProxyType({})

    @property
    def clock(self) -> str:
        """The time system of the epochs."""
        return self.time_system or OWN_CLOCK.get(self.system, "GPS")

    def fields(self, satellite: str, row: int = 0) -> list[ObservationField]:
        """The fields of a satellite, or of its system, whose first line is `row`."""
        key, per_line, begin = satellite[:1], MOST_TYPES, NAME
        if self.version < 3.0:
            key, per_line, begin = "", PER_LINE_2, 0
        return [
            ObservationField(
                kind,
                row + i // per_line,
                begin + FIELD * (i % per_line),
                self.scales.get((satellite[:1], kind), 1.0),
            )
            for i, kind in enumerate(self.types.get(key, ()))
        ]

    def with_records(self, lines: Iterable[str]) -> "ObservationHeader":
        """The header after further records; unknown records are skipped."""
        new, system = self, ""
        types, scales = dict(self.types), dict(self.scales)
        channels = dict(self.channels)
        for line in lines:
            label, words = line[60:80].strip(), line[6:60].split()
            if label == "RINEX VERSION / TYPE":  # another file, appended
                version = _number_or(line[:9], self.version)
                new = ObservationHeader(version, line[40:41].strip() or "G")
                types, scales, channels = {}, {}, {}
            elif label == "SYS / # / OBS TYPES":
                if line[0] != " ":  # blank in continuation lines
                    system = line[0]
                    types[system] = ()
                types[system] = (*types.get(system, ()), *words)
            elif label == "# / TYPES OF OBSERV":
                types[""] = (*(() if line[:6].strip() else types.get("", ())), *words)
            elif label == "TIME OF FIRST OBS":
                new = msgspec.structs.replace(new, time_system=line[48:51].strip())
            elif label == "SYS / SCALE FACTOR":
                system = line[0] if line[0] != " " else system
                factor = _number_or(line[2:6], 1.0)
                names = line[10:60].split() or types.get(system, ())
                scales |= {(system, name): factor for name in names}
            elif label == "GLONASS SLOT / FRQ #":
                words = line[4:60].split()
                pairs = zip(words[::2], words[1::2], strict=False)
                channels |= {name: int(k) for name, k in pairs if k.lstrip("-").isdigit()}
        return msgspec.structs.replace(new, types=types, scales=scales, channels=channels)


def _number_or(text: str, default: float) -> float:
    try:
        return float(text) or default
    except ValueError:
        return default
