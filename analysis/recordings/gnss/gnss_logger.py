"""Read logs of Android telephones (GnssLogger, GPSTest: text, rows `Raw`): ranges on L1 and L5.

A telephone reports when a signal was sent, within its week, day or code period, and its own clock;
the pseudorange is the difference times the speed of light [1]_. The clock's first bias is kept
until the hardware clock is set, so that the receiver clock stays continuous. Ephemerides must come
from navigation files.

References
----------
.. [1] European GNSS Agency, Using GNSS raw measurements on Android devices, 2017, 2.4.
.. [2] Android API reference, `GnssMeasurement` (states, constellations), `GnssClock`.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from datetime import date, timedelta
from itertools import groupby
from pathlib import Path

from analysis.orbits.glonass import CENTRE_HZ, CHANNEL_HZ
from analysis.recordings.gnss.rinex_observations import (
    SAME_CARRIER,
    SECOND,
    CodeObservation,
    carrier_of,
    epoch_of,
)
from analysis.samples.sample import Epoch
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.gps_clock import BEIDOU_OFFSET_S, leap_seconds

# By constellation [2]_: letter, number of the first satellite less one, signals (the usual first).
SYSTEMS = {
    "1": ("G", 0, ("1C", "5Q")),
    "3": ("R", 0, ("1C",)),
    "4": ("J", 192, ("1C", "5Q")),
    "5": ("C", 0, ("2I", "5P")),
    "6": ("E", 0, ("1C", "5Q")),
}
DAY_NS, WEEK_NS, SECOND_CODE_NS = 86_400 * 10**9, 604_800 * 10**9, 100 * 10**6
# States [2]_: the code is locked, Galileo's secondary code too, the time of week or day is known.
CODE, GALILEO_CODE, SECOND_CODE = 1 << 0, 1 << 10, 1 << 11
TIME_KNOWN, DAY_KNOWN = 1 << 3 | 1 << 14, 1 << 7 | 1 << 15
MOSCOW_NS = 3 * 3600 * 10**9  # GLONASS days begin at midnight in Moscow
MOST_SENT_ERROR_NS = 500.0  # of the time of transmission: above it the code is barely locked
LAST_GLONASS = 24  # larger numbers are channels of satellites that are not identified
GPS_DAY_ZERO = date(1980, 1, 6)


def read_gnss_logger(path: Path) -> list[Epoch]:
    """All epochs of a telephone's log.

    Raises
    ------
    ConfigError
        If the log cannot be read or holds no pseudoranges.
    """
    try:
        lines = path.read_text("utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    found = list(_epochs(lines))
    if not found:
        raise ConfigError(f"{path}: no row `Raw` with a pseudorange; give a log of GnssLogger")
    return found


def _epochs(lines: list[str]) -> Iterator[Epoch]:
    names = next((line[1:] for line in lines if line[1:].lstrip().startswith("Raw,")), "")
    columns = [name.strip() for name in names.split(",")]
    table = csv.reader(line for line in lines if line.startswith("Raw,"))
    known = (dict(zip(columns, fields, strict=False)) for fields in table)
    timed = (row for row in known if row.get("TimeNanos"))
    discontinuities, bias_ns, channels = "", 0, dict[str, int]()
    for clock, together in groupby(timed, lambda row: row["TimeNanos"]):
        rows: tuple[dict[str, CodeObservation], ...] = {}, {}
        at_ns = -1
        for row in together:
            try:
                if at_ns < 0:
                    count = row["HardwareClockDiscontinuityCount"]
                    if discontinuities != count or not bias_ns:
                        bias_ns, discontinuities = int(row["FullBiasNanos"]), count
                    at_ns = int(clock) - bias_ns
                found = _observation(row, at_ns)
            except (KeyError, ValueError):
                continue  # a damaged row
            if found is not None:
                rows[found[3] in SECOND[found[0][0]]].setdefault(found[0], found)
                if found[0][0] == "R":
                    offset_hz = float(row["CarrierFrequencyHz"] or CENTRE_HZ) - CENTRE_HZ
                    channels[found[0]] = round(offset_hz / CHANNEL_HZ)
        week, tow_ns = divmod(at_ns, WEEK_NS)
        epoch = epoch_of(week, tow_ns * 1e-9, rows[0].values(), channels, rows[1])
        if epoch is not None:
            yield epoch


def _observation(row: Mapping[str, str], at_ns: int) -> CodeObservation | None:
    """The code observation of a row received at `at_ns` of GPS time; None where it has no range."""
    if row["ConstellationType"] not in SYSTEMS:
        return None
    system, first, signals = SYSTEMS[row["ConstellationType"]]
    carriers_hz = {carrier_of(system, signal): signal for signal in signals}
    number, state = int(row["Svid"]) - first, int(row["State"])
    received_hz = float(row.get("CarrierFrequencyHz") or next(iter(carriers_hz)))
    carrier_hz = min(carriers_hz, key=lambda hz: abs(hz - received_hz))
    sent_error_ns = float(row["ReceivedSvTimeUncertaintyNanos"])
    if abs(received_hz / carrier_hz - 1.0) > SAME_CARRIER or sent_error_ns > MOST_SENT_ERROR_NS:
        return None
    # The period within which the time of transmission is known, and the system's clock.
    offset_ns, period_ns, known = 0, WEEK_NS, bool(state & TIME_KNOWN and state & CODE)
    if system == "R":
        today = GPS_DAY_ZERO + timedelta(days=at_ns // DAY_NS)
        offset_ns, period_ns = MOSCOW_NS - leap_seconds(today) * 10**9, DAY_NS
        known = bool(state & DAY_KNOWN and state & CODE) and number <= LAST_GLONASS
    elif system == "C":
        offset_ns = round(BEIDOU_OFFSET_S * -1e9)
    elif system == "E":
        known = bool(state & TIME_KNOWN and state & (CODE | GALILEO_CODE))
        if not known and state & SECOND_CODE:
            period_ns, known = SECOND_CODE_NS, True
    if not known:
        return None
    travel_ns = float((at_ns + offset_ns - int(row["ReceivedSvTimeNanos"])) % period_ns)
    travel_ns += float(row["TimeOffsetNanos"] or 0.0)
    rate_mps = float(row["PseudorangeRateMetersPerSecond"] or math.nan)
    doppler_hz = -rate_mps * received_hz / SPEED_OF_LIGHT_MPS
    values = travel_ns * 1e-9 * SPEED_OF_LIGHT_MPS, doppler_hz, float(row["Cn0DbHz"])
    return f"{system}{number:02d}", values, carrier_hz, carriers_hz[carrier_hz]
