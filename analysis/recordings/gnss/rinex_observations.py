"""Read RINEX 2, 3 and 4 observation files: code ranges, Doppler and C/N0 of each satellite.

Only the signals that the detector uses are read: L1 of GPS and QZSS, Galileo E1, GLONASS G1, and
B1I or B3I of BeiDou, and one on a second frequency. Of each satellite the first signal of
`PREFERRED`, and of `SECOND`, with a value is used, always on the carrier of its first observation
[1]_ [2]_. `mavproxy_fault.rinex` finds the epochs.

References
----------
.. [1] IGS/RTCM, RINEX 3.05 and 4.01, tables A2, A3. Hatanaka's compression: package `hatanaka`.
.. [2] W. Gurtner, RINEX 2.11, tables A1, A2.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from analysis.orbits.glonass import CENTRE_HZ, CHANNEL_HZ, G2_HZ
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.observation_header import ObservationField, ObservationHeader
from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.rinex_text import check_header, read_rinex_text
from mavproxy_fault.rinex.signal_fields import CARRIERS_MHZ, VALUE

PREFERRED = {
    "G": ("1C", "1X", "1L", "1S", "1W", "1P"),
    "E": ("1C", "1X", "1B", "1A"),
    "R": ("1C", "1P"),
    "C": ("2I", "1I", "2X", "6I", "6X"),  # 1I is what RINEX 3.02 calls B1I
    "J": ("1C", "1E", "1X", "1L", "1S"),  # 1E: C/B, which later satellites send in place of C/A
}
SECOND = {
    "G": ("2W", "2P", "2L", "2X", "2S", "5Q", "5X", "5I"),
    "E": ("7Q", "7X", "7I", "5Q", "5X", "5I"),
    "R": ("2C", "2P"),
    "C": ("6I", "6X", "7I", "7X", "5P", "5X"),
    "J": ("2L", "2X", "2S", "5Q", "5X", "5I"),
}
# Of RINEX 2, which does not know BeiDou. GPS's C2 is L2C, of which 2S stands for any.
CODES_2 = {"1C": "C1", "1P": "P1", "2W": "P2", "2P": "P2", "2S": "C2", "2C": "C2"}
CODES_2 |= {"5X": "C5", "7X": "C7"}
SAME_CARRIER = 0.004  # GLONASS channels are within 0.3 % of channel 0; B1I is 0.9 % from L1
ABSENT = ObservationField("", 0, 1 << 20)  # beyond the end of any line
# Satellite; code in m, Doppler in Hz, C/N0 in dBHz; carrier in Hz (GLONASS: channel 0); signal.
CodeObservation = tuple[str, tuple[float, float, float], float, str]
NOT_OBSERVED = (math.nan, math.nan, math.nan), math.nan, ""


class _Signal(NamedTuple):
    """Fields of code, Doppler and C/N0 of one signal, lines counted from a satellite's first; code
    and carrier (GLONASS: of channel 0)."""

    fields: tuple[ObservationField, ...]
    signal: str
    carrier_hz: float


def read_observations(path: Path, lines: list[str] | None = None) -> list[Epoch]:
    """All epochs of an observation file in file order; `t_us` counts from the start of GPS time.
    `lines` are its lines, if they were modified beforehand.

    Raises
    ------
    ConfigError
        If the file is not a RINEX observation file.
    """
    lines = read_rinex_text(path) if lines is None else lines
    check_header(path, lines, "O", "an observation file")
    return list(_epochs(lines))


def _signals(header: ObservationHeader, system: str, preferred: tuple[str, ...]) -> list[_Signal]:
    """A system's signals in the file, in order of preference."""
    # Of a type that is named twice the first.
    fields, found = {field.name: field for field in reversed(header.fields(system))}, []
    for signal in preferred:
        kinds = "C" + signal, "D" + signal, "S" + signal
        if header.version < 3.0:
            kinds = CODES_2.get(signal, ""), "D" + signal[0], "S" + signal[0]
        if kinds[0] in fields:
            own = tuple(fields.get(kind, ABSENT) for kind in kinds)
            found.append(_Signal(own, signal, carrier_of(system, signal)))
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
        texts = [lines[row + f.at][f.column : f.column + VALUE] for f in signal.fields]
        range_m = float(texts[0]) / signal.fields[0].scale
        # RINEX files use blank, zero or NaN for a missing value.
        if not range_m > 0.0:
            return None
        doppler_hz, cn0_dbhz = (math.nan if not t or t.isspace() else float(t) for t in texts[1:])
        return range_m, doppler_hz, cn0_dbhz
    except ValueError:
        return None


def epoch_of(
    week: int,
    tow_s: float,
    rows: Iterable[CodeObservation],
    channels: Mapping[str, int],
    seconds: Mapping[str, CodeObservation] = MappingProxyType({}),
) -> Epoch | None:
    """Build an epoch; `channels` are those of GLONASS, `seconds` what is observed of a satellite on
    a second frequency. None without any range."""
    rows, second = list(rows), None
    if not rows:
        return None
    # BeiDou's first range may be the one on B3I.
    others = {n: seconds[n] for n, _, hz, _ in rows if n in seconds and seconds[n][2] != hz}
    if others:
        unseen = [others.get(name, (name, *NOT_OBSERVED)) for name, *_ in rows]
        second = epoch_of(week, tow_s, unseen, channels)
    table = np.array([row[1] for row in rows])
    carriers: Vector | None = None
    # A positive Doppler shift means an approaching satellite.
    rates = table[:, 1] * (-SPEED_OF_LIGHT_MPS / L1_HZ)
    if any(row[2] != L1_HZ for row in rows):
        # The carriers of a GLONASS channel have the same ratio.
        centres = np.array([row[2] for row in rows])
        shift = np.array([CHANNEL_HZ * channels.get(name, 0) for name, *_ in rows])
        carriers = centres + shift * (centres / CENTRE_HZ)
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
        second=second,
    )


def _epochs(lines: list[str]) -> Iterator[Epoch]:
    carriers: tuple[dict[str, float], ...] = {}, {}  # of each satellite, at its first ranges
    header: ObservationHeader | None = None
    signals: list[dict[str, list[_Signal]]] = []
    for epoch in file_epochs(lines):
        if epoch.header is not header:  # header records within the file
            header = epoch.header
            signals = [
                {system: _signals(header, system, codes) for system, codes in table.items()}
                for table in (PREFERRED, SECOND)
            ]
        rows: tuple[dict[str, CodeObservation], ...] = {}, {}
        for name, row in epoch.rows.items():
            for known, kept, found in zip(signals, carriers, rows, strict=True):
                for signal in known.get(name[0], ()):
                    values, hz = _values(lines, row, signal), signal.carrier_hz
                    if values is not None and kept.setdefault(name, hz) == hz:
                        found[name] = name, values, hz, signal.signal
                        break
        channels = epoch.header.channels
        made = epoch_of(epoch.week, epoch.tow_s, rows[0].values(), channels, rows[1])
        if made is not None:
            yield made
