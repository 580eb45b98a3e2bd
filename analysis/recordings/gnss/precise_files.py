"""Read precise orbits (SP3, versions a to d) and clocks (RINEX CLK) of satellites.

A precise orbit is of the satellite's centre of mass, and its clock of two frequencies: the group
delay of one frequency is that of the broadcast ephemerides. Only GPS, Galileo and QZSS are used;
the clocks of the others refer to other signals than their broadcast ones.

References
----------
.. [1] S. Hilla, The Extended Standard Product 3 Orbit Format (SP3-d), 2016.
.. [2] J. Ray and W. Gurtner, RINEX Extensions to Handle Clock Information, 3.04, 2017.
"""

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from analysis.orbits.precise import precise_orbits
from analysis.samples.sample import EphemerisSample, Orbit, Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.gps_clock import WEEK_S, time_of_words
from mavproxy_fault.rinex.rinex_text import read_lines
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

USED = "GEJ"
NAMES = re.compile(r"\.(sp3|clk)\w*(\.(gz|z|bz2|zip))?$", re.IGNORECASE)  # their ends
NO_CLOCK_US = 999999.0  # and more: the clock is unknown [1]_
Tables = dict[str, dict[float, tuple[float, ...]]]  # by satellite and second of GPS time


def read_precise(paths: Iterable[Path]) -> tuple[Tables, Tables]:
    """Positions in m and clocks in s of the files; a clock file's clocks replace those of orbits.

    Raises
    ------
    ConfigError
        If a file cannot be read or is damaged.
    """
    orbits, clocks, own = Tables(), Tables(), Tables()
    for path in paths:
        lines = read_lines(path)
        try:
            if lines[0].startswith("#"):
                _read_sp3(lines, orbits, clocks)
            else:
                _read_clocks(lines, own)
        except (IndexError, ValueError) as error:
            raise ConfigError(f"{path}: is damaged ({error}); give the complete file") from error
    return orbits, clocks | own


def precise_samples(
    tables: tuple[Tables, Tables], broadcast: Sequence[Orbit], begin_s: float, end_s: float
) -> list[EphemerisSample]:
    """The orbits from `begin_s` to `end_s` in s of GPS time, of satellites with a broadcast
    ephemeris; with timestamp 0."""
    orbits, clocks = tables
    # Galileo's precise clocks are of E1 and E5a, like those of F/NAV.
    delays_s = {
        e.satellite: e.group_delay_e5a_s or e.group_delay_s
        for e in broadcast
        if isinstance(e, Ephemeris)
    }
    return [
        EphemerisSample(0, orbit)
        for name, rows in orbits.items()
        if name in delays_s and name in clocks
        for orbit in precise_orbits(
            name, _table(rows), _table(clocks[name]), delays_s[name], begin_s, end_s
        )
    ]


def _table(rows: dict[float, tuple[float, ...]]) -> Vector:
    return np.array([(t_s, *values) for t_s, values in sorted(rows.items())])


def _read_sp3(lines: list[str], orbits: Tables, clocks: Tables) -> None:
    system = next((line[9:12] for line in lines if line.startswith("%c")), "GPS")
    t_s = math.nan
    for line in lines:
        if line.startswith("*"):
            t_s = _seconds(line.split()[1:7], system)
        elif line.startswith("P"):
            name = ("G" if line[1] == " " else line[1]) + line[2:4].replace(" ", "0")
            x, y, z, clock_us = (float(line[k : k + 14]) for k in (4, 18, 32, 46))
            if name[0] in USED and x:  # zeros: no position
                orbits.setdefault(name, {})[t_s] = 1e3 * x, 1e3 * y, 1e3 * z
                if clock_us < NO_CLOCK_US:
                    clocks.setdefault(name, {})[t_s] = (1e-6 * clock_us,)


def _read_clocks(lines: list[str], clocks: Tables) -> None:
    heads = (line for line in lines if line[60:].startswith("TIME SYSTEM ID"))
    system = next(heads, "GPS").split()[0]
    for line in lines:
        words = line.split()
        if line.startswith("AS ") and words[1][0] in USED:
            t_s = _seconds(words[2:8], system)
            clocks.setdefault(words[1], {})[t_s] = (float(words[9].replace("D", "E")),)


def _seconds(words: list[str], system: str) -> float:
    week, tow_s = time_of_words(words, system)
    return week * WEEK_S + tow_s
