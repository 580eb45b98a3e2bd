"""Read RINEX 2, 3 and 4 observation files: one code range, Doppler and C/N0 per satellite.

Only the signals that the detector uses are read: L1 of GPS and QZSS, Galileo E1, GLONASS G1, and
B1I or B3I of BeiDou. Of each satellite the first signal of `PREFERRED` with a value is used, always
on the carrier of its first observation [1]_ [2]_. `mavproxy_fault.rinex` finds the epochs.

References
----------
.. [1] IGS/RTCM, RINEX 3.05 and 4.01, tables A2, A3. Hatanaka's compression: package `hatanaka`.
.. [2] W. Gurtner, RINEX 2.11, tables A1, A2.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.orbits.glonass import CENTRE_HZ, CHANNEL_HZ, G2_HZ
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.observation_header import ObservationHeader
from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.rinex_text import header_of, read_rinex_text
from mavproxy_fault.rinex.signal_fields import CARRIERS_MHZ, VALUE

PREFERRED = {
    "G": ("1C", "1X", "1L", "1S", "1W", "1P"),
    "E": ("1C", "1X", "1B", "1A"),
    "R": ("1C", "1P"),
    "C": ("2I", "1I", "2X", "6I", "6X"),  # 1I is what RINEX 3.02 calls B1I
    "J": ("1C", "1E", "1X", "1L", "1S"),  # 1E: C/B, which later satellites send in place of C/A
}
CODES_2 = {"1C": "C1", "1P": "P1"}  # of RINEX 2, which does not know BeiDou
SAME_CARRIER = 0.004  # GLONASS channels are within 0.3 % of channel 0; B1I is 0.9 % from L1
ABSENT_COLUMN = 1 << 20  # beyond the end of any line
# Satellite; code in m, Doppler in Hz, C/N0 in dBHz; carrier in Hz (GLONASS: channel 0); signal.
CodeObservation = tuple[str, tuple[float, float, float], float, str]


class _Signal(NamedTuple):
    """Lines after a satellite's first and start columns of code, Doppler and C/N0 of one signal,
    the factor of the stored code; code and carrier (GLONASS: of channel 0)."""

    places: tuple[tuple[int, int], ...]
    scale: float
    signal: str
    carrier_hz: float


def read_observations(path: Path) -> list[Epoch]:
    """All epochs of an observation file in file order; `t_us` counts from the start of GPS time.

    Raises
    ------
    ConfigError
        If the file is not a RINEX observation file.
    """
    return epochs_of(path, read_rinex_text(path))


def epochs_of(path: Path, lines: list[str]) -> list[Epoch]:
    """All epochs in the lines of an observation file; `path` is used in errors."""
    header_of(path, lines, "O", "an observation file")
    return list(_epochs(lines))


def _signals(header: ObservationHeader, system: str) -> list[_Signal]:
    """A system's signals in the file, in order of preference."""
    types = header.types_of(system)
    found = []
    for signal in PREFERRED[system]:
        code, rest = "C" + signal, ("D" + signal, "S" + signal)
        if header.version < 3.0:
            code, rest = CODES_2.get(signal, ""), ("D1", "S1")
        if code in types:
            places = [
                header.place(types.index(kind)) if kind in types else (0, ABSENT_COLUMN)
                for kind in (code, *rest)
            ]
            scale, carrier_hz = header.scale_of(system, code), carrier_of(system, signal)
            found.append(_Signal(tuple(places), scale, signal, carrier_hz))
    return found


def carrier_of(system: str, signal: str) -> float:
    """The carrier of a signal, of GLONASS that of channel 0."""
    if system == "R":
        return CENTRE_HZ if signal[0] == "1" else G2_HZ
    band = "2" if system == "C" and signal == "1I" else signal[0]
    return round(CARRIERS_MHZ[system][band] * 1e6)


def _values(lines: list[str], row: int, signal: _Signal) -> tuple[float, float, float] | None:
    """Code, Doppler and C/N0 of a satellite; None without a valid code range."""
    try:
        texts = [lines[row + line][column : column + VALUE] for line, column in signal.places]
        range_m = float(texts[0]) / signal.scale
        # RINEX files use blank, zero or NaN for a missing value.
        if not range_m > 0.0:
            return None
        doppler_hz, cn0_dbhz = (math.nan if not t or t.isspace() else float(t) for t in texts[1:])
        return range_m, doppler_hz, cn0_dbhz
    except ValueError:
        return None


def epoch_of(
    week: int, tow_s: float, rows: list[CodeObservation], channels: Mapping[str, int]
) -> Epoch | None:
    """Build an epoch; `channels` are those of GLONASS. None without any range."""
    if not rows:
        return None
    table = np.array([row[1] for row in rows])
    carriers: Vector | None = None
    # A positive Doppler shift means an approaching satellite.
    rates = table[:, 1] * (-SPEED_OF_LIGHT_MPS / L1_HZ)
    if any(row[2] != L1_HZ for row in rows):
        carriers = np.array([hz + CHANNEL_HZ * channels.get(name, 0) for name, _, hz, _ in rows])
        unknown = [name[0] == "R" and name not in channels for name, *_ in rows]
        rates = np.where(unknown, np.nan, table[:, 1] * (-SPEED_OF_LIGHT_MPS / carriers))
    return Epoch(
        t_us=round((week * 604_800 + tow_s) * 1e6),
        week=week,
        tow_s=tow_s,
        satellites=tuple(row[0] for row in rows),
        pseudorange_m=table[:, 0].copy(),
        doppler_mps=rates,
        cn0_dbhz=table[:, 2].copy(),
        carrier_hz=carriers,
        signals=tuple(row[3] for row in rows),
    )


def _epochs(lines: list[str]) -> Iterator[Epoch]:
    carriers: dict[str, float] = {}  # of each satellite, at its first range
    header: ObservationHeader | None = None
    signals: dict[str, list[_Signal]] = {}
    for epoch in file_epochs(lines):
        if epoch.header is not header:  # header records within the file
            header = epoch.header
            signals = {system: _signals(header, system) for system in PREFERRED}
        rows = []
        for name, row in epoch.rows.items():
            for signal in signals.get(name[0], ()):
                values = _values(lines, row, signal)
                carrier_hz = signal.carrier_hz
                if values is not None and carriers.setdefault(name, carrier_hz) == carrier_hz:
                    rows.append((name, values, carrier_hz, signal.signal))
                    break
        found = epoch_of(epoch.week, epoch.tow_s, rows, epoch.header.channels)
        if found is not None:
            yield found
