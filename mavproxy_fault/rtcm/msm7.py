"""RTCM 3 MSM7: pseudoranges, phase ranges, Doppler and C/N0 of one system, GPS or Galileo.

Every range is a rough part in steps of 1/1024 light-millisecond, common to all signals of a
satellite, and a fine part per signal: 2^-29 ms (0.56 mm) for the pseudorange, 2^-31 ms for the
phase range. A rate is an integer in m/s per satellite plus 0.1 mm/s per signal [1]_. `encode_msm7`
writes one signal per satellite, GPS L1 C/A or Galileo E1 C; `patch_msm7` accepts any message with
one of the two numbers.

References
----------
.. [1] RTCM 10403.3, section 3.5.16, tables 3.5-78 to 3.5-99 (DF393 to DF408).
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.rtcm.bit_fields import BitReader, pack_columns
from mavproxy_fault.rtcm.transport import unwrap_message, wrap_message

NUMBERS = {"G": 1077, "E": 1097}
SYSTEMS = {number: system for system, number in NUMBERS.items()}
SIGNAL = 2  # GPS L1 C/A (1C) and Galileo E1 C (1C) have the same number in their signal masks

MS_M = SPEED_OF_LIGHT_MPS / 1000.0
WEEK_MS = 604_800_000

ROUGH = 1024  # steps of a millisecond
FINE_PER_ROUGH = 1 << 19  # pseudorange counts (2^-29 ms) in one rough step
PHASE_PER_ROUGH = 1 << 21  # phase counts (2^-31 ms) in one rough step
ROUGH_INVALID = 255  # whole milliseconds
RATE_INVALID = -(1 << 13)
FINE_INVALID = -(1 << 19)
PHASE_INVALID = -(1 << 23)
FINE_RATE_INVALID = -(1 << 14)
CN0_STEP_DBHZ = 0.0625
# DF397, extended information, DF398, DF399; the order is that of the message.
SATELLITE_WIDTHS = {"rough_ms": 8, "info": 4, "rough": 10, "rate": 14}  # bits
CELL_WIDTHS = (20, 24, 10, 1, 10, 15)  # bits of fine range, phase, lock, half cycle, C/N0, rate


@dataclass(frozen=True, slots=True)
class Msm7:
    """One epoch of one system, one signal per satellite; the tuples run in parallel.

    `tow_s` is GPS time of week by the receiver's clock (Galileo's differs by nanoseconds), sent in
    integer milliseconds. `doppler_mps` is the range rate. NaN means "not given"; `lock_s` is the
    time of carrier tracking without a cycle slip. `more` means that another message of the same
    epoch follows.
    """

    system: str
    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: tuple[float, ...]
    phase_m: tuple[float, ...]
    doppler_mps: tuple[float, ...]
    cn0_dbhz: tuple[float, ...]
    lock_s: tuple[float, ...]
    more: bool = False


class _Satellite(NamedTuple):
    """The integers of one satellite as sent; `cells` has [fine, phase, lock, half-cycle flag, C/N0,
    fine rate] by signal."""

    rough_ms: int
    info: int
    rough: int
    rate: int
    cells: dict[int, tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class _Message:
    """A message as integers: station, epoch time, flags, and satellites by number."""

    number: int
    station: int
    epoch_ms: int
    more: int
    flags: int
    satellites: dict[int, _Satellite]


def encode_msm7(data: Msm7) -> bytes:
    """Encode the complete RTCM message of one epoch of one system.

    Satellites without a valid pseudorange, or of another system, are omitted.

    Raises
    ------
    KeyError
        If the system is neither `G` nor `E`.
    """
    satellites = {}
    for i, name in enumerate(data.satellites):
        if name[0] == data.system and 0.0 <= data.pseudorange_m[i] < ROUGH_INVALID * MS_M:
            satellites[int(name[1:])] = _satellite(
                data.pseudorange_m[i],
                data.phase_m[i],
                data.doppler_mps[i],
                data.cn0_dbhz[i],
                data.lock_s[i],
            )
    # The end of the week may round up to the next week.
    epoch_ms = round(data.tow_s * 1000.0) % WEEK_MS
    return _encode(
        _Message(
            NUMBERS[data.system], 0, epoch_ms, int(data.more), 0, dict(sorted(satellites.items()))
        )
    )


def encode_epoch(
    tow_s: float,
    satellites: Sequence[str],
    pseudorange_m: Sequence[float],
    doppler_mps: Sequence[float],
    cn0_dbhz: Sequence[float],
) -> list[bytes]:
    """Encode the messages of one epoch without phase: 1077 and 1097, if they have satellites."""
    found = [s for s in NUMBERS if any(name[0] == s for name in satellites)]
    messages = []
    for system in found:
        rows = sorted(
            (int(name[1:]), *_range_counts(range_m), *_rate_counts(rate), _cn0_count(cn0))
            for name, range_m, rate, cn0 in zip(
                satellites, pseudorange_m, doppler_mps, cn0_dbhz, strict=True
            )
            if name[0] == system and 0.0 <= range_m < ROUGH_INVALID * MS_M
        )
        # Six columns even without satellites, so that no special case is needed.
        columns = list(zip(*rows, strict=True)) or [()] * 6
        numbers, rough, fine, rate, fine_rate, cn0 = columns
        nothing = (0,) * len(rows)
        head = (NUMBERS[system], 0, round(tow_s * 1000.0) % WEEK_MS, int(system != found[-1]), 0)
        ranges = ([r // ROUGH for r in rough], nothing, [r % ROUGH for r in rough], rate)
        signal = (fine, (PHASE_INVALID,) * len(rows), nothing, nothing, cn0, fine_rate)
        messages.append(_packed(head, numbers, (SIGNAL,), (1,) * len(rows), ranges, signal))
    return messages


def decode_msm7(message: bytes) -> Msm7:
    """Decode one signal per satellite: the first one in the signal mask with a pseudorange.

    Raises
    ------
    ValueError
        If it is not a complete 1077 or 1097 message with a valid CRC.
    """
    raw = _decode(message)
    system = SYSTEMS[raw.number]
    names, rows = [], []
    for number, satellite in raw.satellites.items():
        values = _values(satellite)
        if values is not None:
            names.append(f"{system}{number:02d}")
            rows.append(values)
    # A message without satellites is valid; its masks are empty.
    ranges, phases, rates, cn0s, locks = zip(*rows, strict=True) if rows else ((),) * 5
    return Msm7(
        system,
        raw.epoch_ms / 1000.0,
        tuple(names),
        ranges,
        phases,
        rates,
        cn0s,
        locks,
        more=bool(raw.more),
    )


def msm7_satellites(message: bytes) -> tuple[str, ...]:
    """Return the names of the satellites of a message, in its order."""
    raw = _decode(message)
    return tuple(f"{SYSTEMS[raw.number]}{number:02d}" for number in raw.satellites)


def patch_msm7(message: bytes, changes_m: Mapping[str, float], lost: Collection[str] = ()) -> bytes:
    """Add metres to pseudoranges of a message, and remove lost satellites.

    All signals of a satellite change alike. If the fine field overflows, the rough range takes the
    complete steps and the phase field is reduced by them, so that the phase range is unchanged;
    beyond about 1.1 km the phase cannot be represented and is marked invalid. A lost satellite is
    removed from the masks, as if the receiver did not track it. Satellites that are not in the
    message are ignored; without changes the message is returned as it is.

    Raises
    ------
    ValueError
        If it is not a complete 1077 or 1097 message with a valid CRC.
    """
    raw = _decode(message)
    system = SYSTEMS[raw.number]
    satellites = {}
    for number, satellite in raw.satellites.items():
        name = f"{system}{number:02d}"
        if name not in lost:
            satellites[number] = _moved(satellite, changes_m.get(name, 0.0))
    # An unchanged message must stay byte for byte.
    if satellites == raw.satellites:
        return message
    return _encode(replace(raw, satellites=satellites))


def _range_counts(range_m: float) -> tuple[int, int]:
    """Split a range into rough steps of 1/1024 ms and the remaining counts of 2^-29 ms."""
    counts = round(range_m / MS_M * ROUGH * FINE_PER_ROUGH)
    rough = (counts + FINE_PER_ROUGH // 2) // FINE_PER_ROUGH
    return rough, counts - rough * FINE_PER_ROUGH


def _rate_counts(rate: float) -> tuple[int, int]:
    """Split a rate into integer m/s and the remaining counts of 0.1 mm/s."""
    # Written so that NaN is out of range too.
    if not abs(rate) < -RATE_INVALID:
        return RATE_INVALID, FINE_RATE_INVALID
    whole = round(rate)
    return whole, round((rate - whole) * 10_000)


def _cn0_count(cn0: float) -> int:
    return min(max(round(cn0 / CN0_STEP_DBHZ), 0), 1023) if math.isfinite(cn0) else 0


def _satellite(range_m: float, phase_m: float, rate: float, cn0: float, lock: float) -> _Satellite:
    rough, fine = _range_counts(range_m)
    phase = PHASE_INVALID
    if math.isfinite(phase_m):
        phase = _within(
            round(phase_m / MS_M * ROUGH * PHASE_PER_ROUGH) - rough * PHASE_PER_ROUGH, PHASE_INVALID
        )
    whole_rate, fine_rate = _rate_counts(rate)
    cell = (fine, phase, _lock_indicator(lock), 0, _cn0_count(cn0), fine_rate)
    return _Satellite(rough // ROUGH, 0, rough % ROUGH, whole_rate, {SIGNAL: cell})


def _values(satellite: _Satellite) -> tuple[float, float, float, float, float] | None:
    """Return range, phase, rate, C/N0 and lock time of the first valid signal; None without one."""
    if satellite.rough_ms == ROUGH_INVALID:
        return None
    rough = satellite.rough_ms * ROUGH + satellite.rough
    for fine, phase, lock, _, cn0, fine_rate in satellite.cells.values():
        if fine == FINE_INVALID:
            continue
        range_m = (rough * FINE_PER_ROUGH + fine) / (ROUGH * FINE_PER_ROUGH) * MS_M
        phase_m = (
            (rough * PHASE_PER_ROUGH + phase) / (ROUGH * PHASE_PER_ROUGH) * MS_M
            if phase != PHASE_INVALID
            else math.nan
        )
        rate = (
            satellite.rate + fine_rate / 10_000
            if satellite.rate != RATE_INVALID and fine_rate != FINE_RATE_INVALID
            else math.nan
        )
        return range_m, phase_m, rate, cn0 * CN0_STEP_DBHZ if cn0 else math.nan, _lock_time(lock)
    return None


def _moved(satellite: _Satellite, change_m: float) -> _Satellite:
    """Add `change_m` to the pseudorange of each signal of a satellite."""
    counts = round(change_m / MS_M * ROUGH * FINE_PER_ROUGH)
    if counts == 0 or satellite.rough_ms == ROUGH_INVALID:
        return satellite
    fines = [cell[0] + counts for cell in satellite.cells.values() if cell[0] != FINE_INVALID]
    steps = 0
    if fines and not all(FINE_INVALID < fine < -FINE_INVALID for fine in fines):
        # The same number of steps for all signals, since they share the rough range.
        steps = round(sum(fines) / len(fines) / FINE_PER_ROUGH)
    rough = satellite.rough_ms * ROUGH + satellite.rough + steps
    if not 0 <= rough < ROUGH_INVALID * ROUGH:
        return satellite._replace(rough_ms=ROUGH_INVALID)
    cells = {}
    for signal, (fine, phase, *rest) in satellite.cells.items():
        if fine != FINE_INVALID:
            fine = _within(fine + counts - steps * FINE_PER_ROUGH, FINE_INVALID)
        if phase != PHASE_INVALID:
            phase = _within(phase - steps * PHASE_PER_ROUGH, PHASE_INVALID)
        cells[signal] = (fine, phase, *rest)
    return satellite._replace(rough_ms=rough // ROUGH, rough=rough % ROUGH, cells=cells)


def _within(value: int, invalid: int) -> int:
    """Return `value`, or the field's invalid mark if it is out of range."""
    return value if invalid < value < -invalid else invalid


def _lock_indicator(lock_s: float) -> int:
    """Encode DF407: milliseconds up to 64, then in steps that double every 32 counts."""
    if not lock_s > 0.0:
        return 0
    lock_ms = int(lock_s * 1000.0)
    if lock_ms < 64:
        return lock_ms
    doublings = min(lock_ms.bit_length() - 6, 20)
    return min(32 * (doublings + 1) + (lock_ms - (32 << doublings) >> doublings), 704)


def _lock_time(indicator: int) -> float:
    """Return the minimum lock time [s] of a DF407 indicator."""
    if indicator < 64:
        return indicator / 1000.0
    doublings = min(indicator // 32 - 1, 21)
    return ((32 << doublings) + (indicator - 32 * (doublings + 1) << doublings)) / 1000.0


def _encode(raw: _Message) -> bytes:
    rows = list(raw.satellites.values())
    signals = sorted({signal for satellite in rows for signal in satellite.cells})
    cells = [satellite.cells[s] for satellite in rows for s in sorted(satellite.cells)]
    return _packed(
        (raw.number, raw.station, raw.epoch_ms, raw.more, raw.flags),
        list(raw.satellites),
        signals,
        [int(s in satellite.cells) for satellite in rows for s in signals],
        [[getattr(satellite, name) for satellite in rows] for name in SATELLITE_WIDTHS],
        list(zip(*cells, strict=True)),
    )


def _packed(
    head: tuple[int, int, int, int, int],
    numbers: Sequence[int],
    signals: Sequence[int],
    present: Sequence[int],
    satellites: Sequence[Sequence[int]],
    cells: Sequence[Sequence[int]],
) -> bytes:
    """Pack the complete message: masks, columns of satellites, columns of signals."""
    return wrap_message(
        pack_columns(
            [
                *zip(((value,) for value in head), (12, 12, 30, 1, 18), strict=True),
                ((sum(1 << (64 - number) for number in numbers),), 64),
                ((sum(1 << (32 - signal) for signal in signals),), 32),
                (present, 1),
                *zip(satellites, SATELLITE_WIDTHS.values(), strict=True),
                *zip(cells, CELL_WIDTHS, strict=False),
            ]
        )
    )


def _decode(message: bytes) -> _Message:
    bits = BitReader(unwrap_message(message))
    number = bits.unsigned(12)
    if number not in SYSTEMS:
        raise ValueError(f"RTCM {number} is not MSM7 of GPS or Galileo (1077, 1097)")
    station, epoch_ms, more = bits.unsigned(12), bits.unsigned(30), bits.unsigned(1)
    flags = bits.unsigned(18)
    numbers = _numbers(bits.unsigned(64), 64)
    signals = _numbers(bits.unsigned(32), 32)
    pairs = [(n, s) for n in numbers for s in signals if bits.unsigned(1)]
    count = len(numbers)
    rough_ms, info, rough = bits.many(count, 8), bits.many(count, 4), bits.many(count, 10)
    rate = bits.many_signed(count, 14)
    total = len(pairs)
    fine, phase = bits.many_signed(total, 20), bits.many_signed(total, 24)
    lock, half, cn0 = bits.many(total, 10), bits.many(total, 1), bits.many(total, 10)
    fine_rate = bits.many_signed(total, 15)
    cells: dict[int, dict[int, tuple[int, ...]]] = {n: {} for n in numbers}
    for (n, s), cell in zip(
        pairs, zip(fine, phase, lock, half, cn0, fine_rate, strict=True), strict=True
    ):
        cells[n][s] = cell
    satellites = {
        n: _Satellite(rough_ms[i], info[i], rough[i], rate[i], cells[n])
        for i, n in enumerate(numbers)
    }
    return _Message(number, station, epoch_ms, more, flags, satellites)


def _numbers(mask: int, width: int) -> list[int]:
    """Return the numbers (from 1) of the bits set in a mask, most significant bit first."""
    return [i + 1 for i in range(width) if mask >> (width - 1 - i) & 1]
