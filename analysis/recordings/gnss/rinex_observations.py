"""Read RINEX 2, 3 and 4 observation files: one code range, Doppler and C/N0 per satellite.

Only the signals that the detector uses are read: L1 of GPS and QZSS, Galileo E1, GLONASS G1, and
B1I or B3I of BeiDou. Of each satellite the first signal of `PREFERRED` with a value is used, always
on the carrier of its first observation [1]_ [2]_. Lines that are not observations are skipped; a
truncated file ends with its last complete epoch.

References
----------
.. [1] IGS/RTCM, RINEX 3.05 and 4.01, tables A2, A3. Hatanaka's compression: package `hatanaka`.
.. [2] W. Gurtner, RINEX 2.11, tables A1, A2.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from analysis.orbits.broadcast import B1I_HZ, B3I_HZ
from analysis.orbits.glonass import CENTRE_HZ, CHANNEL_HZ
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.rinex_text import header_of, read_rinex_text, types_2, types_3

PREFERRED = {
    "G": ("1C", "1X", "1L", "1S", "1W", "1P"),
    "E": ("1C", "1X", "1B", "1A"),
    "R": ("1C", "1P"),
    "C": ("2I", "1I", "2X", "6I", "6X"),  # 1I is what RINEX 3.02 calls B1I
    "J": ("1C", "1E", "1X", "1L", "1S"),  # 1E: C/B, which later satellites send in place of C/A
}
BEIDOU_HZ = {"1": B1I_HZ, "2": B1I_HZ, "6": B3I_HZ}  # by the band
GPS_DAY_ZERO = date(1980, 1, 6).toordinal()
WEEK_DAYS = 7
FIELD_WIDTH = 16  # F14.3, loss of lock, signal strength
ABSENT_COLUMN = 1 << 20  # beyond the end of any line
# Satellite; code in m, Doppler in Hz, C/N0 in dBHz; carrier in Hz (GLONASS: channel 0); signal.
CodeObservation = tuple[str, tuple[float, float, float], float, str]


@dataclass(frozen=True, slots=True)
class _Columns:
    """Start columns of code, Doppler and C/N0 of one signal, its code and carrier (GLONASS: of
    channel 0)."""

    code: int
    doppler: int
    cn0: int
    signal: str
    carrier_hz: float = L1_HZ


def _column_starts(
    first: int, places: list[int], signal: str, carrier_hz: float = L1_HZ
) -> _Columns:
    """Start columns from indices of observation types (-1: absent); the first field starts at
    `first`."""
    starts = [first + FIELD_WIDTH * place if place >= 0 else ABSENT_COLUMN for place in places]
    return _Columns(starts[0], starts[1], starts[2], signal, carrier_hz)


def gps_time(year: int, month: int, day: int, seconds_of_day: float) -> tuple[int, float]:
    """GPS week and seconds of week of a calendar date in GPS time."""
    days = date(year, month, day).toordinal() - GPS_DAY_ZERO
    return days // WEEK_DAYS, days % WEEK_DAYS * 86_400.0 + seconds_of_day


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
    version, start = header_of(path, lines, "O", "an observation file")
    channels = _channels(lines[:start])
    if version < 3.0:
        return list(_epochs_2(lines, start + 1, _types_2(lines[:start]), channels))
    return list(_epochs_3(lines, start + 1, _types_3(lines[:start]), channels))


def _signals(system: str, types: list[str]) -> list[_Columns]:
    """Columns of a system's signals in the file, in order of preference."""
    return [
        _column_starts(
            3,
            [types.index(k + signal) if k + signal in types else -1 for k in "CDS"],
            signal,
            _carrier_hz(system, signal),
        )
        for signal in PREFERRED[system]
        if "C" + signal in types
    ]


def _carrier_hz(system: str, signal: str) -> float:
    if system == "R":
        return CENTRE_HZ
    return BEIDOU_HZ[signal[0]] if system == "C" else L1_HZ


def _channels(header: list[str]) -> dict[str, int]:
    """Frequency channels of GLONASS satellites from the header."""
    found: dict[str, int] = {}
    for line in header:
        if line[60:].startswith("GLONASS SLOT / FRQ #"):
            words = line[4:60].split()
            pairs = zip(words[::2], words[1::2], strict=False)
            found |= {name: int(k) for name, k in pairs if k.lstrip("-").isdigit()}
    return found


def _types_3(header: list[str]) -> dict[str, list[_Columns]]:
    types = types_3(header)
    return {system: _signals(system, types[system]) for system in PREFERRED if system in types}


def _types_2(header: list[str]) -> tuple[int, _Columns]:
    names = types_2(header)
    code = names.index("C1") if "C1" in names else names.index("P1") if "P1" in names else -1
    places = [names.index(k) if k in names else -1 for k in ("D1", "S1")]
    return len(names), _column_starts(0, [code, *places], "1C" if "C1" in names else "1P")


def _number(text: str) -> float:
    """The number in a field; NaN if blank."""
    return math.nan if not text or text.isspace() else float(text)


def _values(line: str, columns: _Columns) -> tuple[float, float, float] | None:
    """Code, Doppler and C/N0 of one line; None without a valid code range."""
    code, doppler, cn0 = columns.code, columns.doppler, columns.cn0
    try:
        range_m = float(line[code : code + 14])
        # RINEX files use blank, zero or NaN for a missing value.
        if not range_m > 0.0:
            return None
        return range_m, _number(line[doppler : doppler + 14]), _number(line[cn0 : cn0 + 14])
    except ValueError:
        return None


def epoch_of(
    week: int, tow_s: float, rows: list[CodeObservation], channels: dict[str, int]
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


def _epochs_3(
    lines: list[str], at: int, types: dict[str, list[_Columns]], channels: dict[str, int]
) -> Iterator[Epoch]:
    carriers: dict[str, float] = {}  # of each satellite, at its first range
    while at < len(lines):
        head = lines[at]
        at += 1
        if not head.startswith(">") or head[31:32] > "1":
            continue
        try:
            week, tow_s = _time(head[2:6], head[6:29])
            count = int(head[32:35])
        except ValueError:
            continue
        rows, last = [], at + count
        for line in lines[at:last]:
            if line.startswith(">"):  # fewer satellites than the epoch header announces
                break
            at += 1
            row = _row(line, types.get(line[:1], []), carriers)
            if row is not None:
                rows.append(row)
        epoch = epoch_of(week, tow_s, rows, channels)
        if epoch is not None and (at == last or at < len(lines)):
            yield epoch


def _row(line: str, signals: list[_Columns], carriers: dict[str, float]) -> CodeObservation | None:
    """A satellite's first signal with a value, on the carrier of its first range."""
    name = line[:3].replace(" ", "0")
    for columns in signals:
        values = _values(line, columns)
        if values is not None and carriers.setdefault(name, columns.carrier_hz) == (
            columns.carrier_hz
        ):
            return name, values, columns.carrier_hz, columns.signal
    return None


def _time(year: str, rest: str) -> tuple[int, float]:
    month, day, hour, minute, second = rest.split()
    return gps_time(
        int(year), int(month), int(day), int(hour) * 3600 + int(minute) * 60 + float(second)
    )


def _epochs_2(
    lines: list[str], at: int, types: tuple[int, _Columns], channels: dict[str, int]
) -> Iterator[Epoch]:
    total, columns = types
    # RINEX 2 has five observations per line.
    per_satellite = -(-total // 5)
    while at < len(lines):
        head = lines[at]
        at += 1
        try:
            year = int(head[1:3])
            week, tow_s = _time(str(year + (1900 if year >= 80 else 2000)), head[3:26])
            flag, count = int(head[26:29]), int(head[29:32])
        except ValueError:
            continue
        names = head[32:68]
        for _ in range((count - 1) // 12):
            names = names.ljust(36) + lines[at][32:68] if at < len(lines) else names
            at += 1
        rows = []
        for i in range(count if flag <= 1 else 0):
            block = lines[at : at + per_satellite]
            at += per_satellite
            name = names[3 * i : 3 * i + 3].replace(" ", "0")
            # RINEX 2 may omit the letter of GPS.
            name = "G" + name[1:] if name[:1] == "0" else name
            values = _values("".join(line.ljust(80)[:80] for line in block), columns)
            if values is not None and name[:1] in "GER":
                carrier_hz = CENTRE_HZ if name[0] == "R" else L1_HZ
                rows.append((name, values, carrier_hz, columns.signal))
        epoch = epoch_of(week, tow_s, rows, channels)
        if epoch is not None and at <= len(lines):
            yield epoch
