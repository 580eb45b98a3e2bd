"""Read pseudoranges of ArduPilot dataflash logs (GRXH and GRXS, logged if GPS_RAW_DATA is set).

They hold the fields of u-blox's RXM-RAWX [1]_, one GRXH per message and one GRXS per range, all of
one message with the same TimeUS, so they are reassembled to RAWX and decoded as that. The signal is
not logged, but u-blox initialises carrier phases near the range [2]_: phase over range gives the
carrier frequency, to 1e-5 in logs that name the signal. A range without a phase is skipped.
Navigation messages are not logged.

References
----------
.. [1] ArduPilot, libraries/AP_GPS/LogStructure.h (GRXH, GRXS), AP_GPS_UBLOX.cpp (`log_rxm_rawx`).
.. [2] u-blox, F9 HPG 1.32 interface description (UBX-22008968), 3.17.4, cpMes.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.dataflash import read_dataflash
from analysis.recordings.flight_logs.logged_rows import Topic
from analysis.recordings.gnss.rinex_observations import SAME_CARRIER
from analysis.recordings.gnss.ubx_log import HEAD, RANGE, SIGNALS, rawx_epoch
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

# Names in the log of RAWX fields.
HEAD_FIELDS = {"tow_s": "rcvTime", "week": "week", "leap_s": "leapS"}
RANGE_FIELDS = {
    "pseudorange_m": "prMes",
    "phase": "cpMes",
    "doppler_hz": "doMes",
    "system": "gnss",
    "satellite": "sv",
    "slot": "freq",
    "lock_ms": "lock",
    "cn0_dbhz": "cno",
    "status": "trk",
}
SAME_EPOCH_S = 0.02  # receivers measure at multiples of 0.1 s of GPS time, within 1 ms


def read_dataflash_ranges(path: Path) -> list[Epoch]:
    """All epochs of the first receiver in a log.

    Raises
    ------
    ConfigError
        If the log cannot be read or holds no pseudoranges.
    """
    topics = read_dataflash(path, ("GRXH", "GRXS")).topics
    heads, ranges = topics.get(("GRXH", 0), {}), topics.get(("GRXS", 0), {})
    head = _rows(path, "GRXH", heads, HEAD, HEAD_FIELDS)
    table = _rows(path, "GRXS", ranges, RANGE, RANGE_FIELDS)
    known = _is_known(table)
    # Sorted, since corrupted parts may break the order of time.
    order = np.argsort(ranges["TimeUS"][known], kind="stable")
    t_us, table = ranges["TimeUS"][known][order], table[known][order]
    begin = np.searchsorted(t_us, heads["TimeUS"], "left")
    end = np.searchsorted(t_us, heads["TimeUS"], "right")
    found = (
        rawx_epoch(head[i].tobytes() + table[begin[i] : end[i]].tobytes())
        for i in _of_one_receiver(head["tow_s"])
    )
    return [epoch for epoch in found if epoch is not None]


def _rows(
    path: Path, name: str, topic: Topic, dtype: np.dtype[Any], fields: dict[str, str]
) -> NDArray[Any]:
    """Convert messages to rows of RAWX."""
    missing = [
        field
        for field in fields.values()
        if field not in topic or topic[field].dtype.kind not in "iuf"
    ]
    if missing:
        raise ConfigError(
            f"{path}: has no {name} with {', '.join(missing)}; set GPS_RAW_DATA to 1 before the"
            " flight, with a u-blox receiver that can send RXM-RAWX"
        )
    rows = np.zeros(len(topic["TimeUS"]), dtype)
    for own, field in fields.items():
        rows[own] = topic[field]
    return rows


def _is_known(table: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask (n,) of the ranges on the carrier that is read of their system: that of signal 0 in
    `SIGNALS`."""
    carrier_hz = np.full(256, np.nan)
    for (system, signal), (_, _, hz) in SIGNALS.items():
        carrier_hz[system] = hz if signal == 0 else carrier_hz[system]
    with np.errstate(divide="ignore", invalid="ignore"):
        own_hz = table["phase"] * SPEED_OF_LIGHT_MPS / table["pseudorange_m"]
    known: NDArray[np.bool_] = np.abs(own_hz / carrier_hz[table["system"]] - 1.0) < SAME_CARRIER
    return known  # NaN (another system, or no phase) compares as false


def _of_one_receiver(tow_s: Vector) -> list[int]:
    """Indices of the first receiver's messages; a second one measures at nearly the same times."""
    kept: list[int] = []
    for i in range(len(tow_s)):
        if not kept or not 0.0 <= tow_s[i] - tow_s[kept[-1]] < SAME_EPOCH_S:
            kept.append(i)
    return kept
