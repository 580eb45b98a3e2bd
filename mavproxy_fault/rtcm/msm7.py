"""RTCM 3 MSM7: pseudoranges, phase ranges, Doppler and C/N0 of one system, GPS or Galileo.

Every range is a rough part in steps of 1/1024 light-millisecond, common to all signals of a
satellite, and a fine part per signal: 2^-29 ms (0.56 mm) for the pseudorange, 2^-31 ms for the
phase range. A rate is an integer in m/s per satellite plus 0.1 mm/s per signal [1]_. `encode_epoch`
writes one signal per satellite, GPS L1 C/A or Galileo E1 C, without phase; `patch_msm7` accepts any
message with one of the two numbers.

References
----------
.. [1] RTCM 10403.3, section 3.5.16, tables 3.5-78 to 3.5-99 (DF393 to DF408).
"""

from collections.abc import Collection, Mapping, Sequence
from math import isfinite, nan
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
# Bits of the fields in the order of the message; negative: signed.
HEAD_BITS = (12, 12, 30, 1, 18)  # number, station, epoch in ms, whether more follow, flags
SATELLITE_BITS = (8, 4, 10, -14)  # whole ms, information, rough range, rate
CELL_BITS = (-20, -24, 10, 1, 10, -15)  # fine range, phase, lock, half cycle, C/N0, fine rate


class Msm7(NamedTuple):
    """One epoch of one system, one signal per satellite; the tuples run in parallel.

    `tow_s` is GPS time of week by the receiver's clock (Galileo's differs by nanoseconds), sent in
    integer milliseconds. `doppler_mps` is the range rate. NaN means "not given". `more` means that
    another message of the same epoch follows.
    """

    system: str
    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: tuple[float, ...]
    doppler_mps: tuple[float, ...]
    cn0_dbhz: tuple[float, ...]
    more: bool


class _Message(NamedTuple):
    """A message as integers: head, satellites by number, and of each cell (satellite, signal) the
    fields; in the order of the message."""

    head: tuple[int, ...]
    satellites: dict[int, tuple[int, ...]]
    cells: dict[tuple[int, int], tuple[int, ...]]

    def name(self, number: int) -> str:
        """The name of a satellite."""
        return f"{SYSTEMS[self.head[0]]}{number:02d}"


def encode_epoch(
    tow_s: float,
    satellites: Sequence[str],
    pseudorange_m: Sequence[float],
    doppler_mps: Sequence[float],
    cn0_dbhz: Sequence[float],
) -> list[bytes]:
    """Encode the messages of one epoch without phase: 1077 and 1097, if they have satellites.

    Satellites without a valid pseudorange are omitted.
    """
    found = [s for s in NUMBERS if any(name[0] == s for name in satellites)]
    # The end of the week may round up to the next week.
    epoch_ms, messages = round(tow_s * 1000.0) % WEEK_MS, []
    rows = sorted(zip(satellites, pseudorange_m, doppler_mps, cn0_dbhz, strict=True))
    for system in found:
        message = _Message((NUMBERS[system], 0, epoch_ms, int(system != found[-1]), 0), {}, {})
        for name, range_m, rate_mps, cn0_dbhz_ in rows:
            if name[0] == system and 0.0 <= range_m < ROUGH_INVALID * MS_M:
                number, counts = int(name[1:]), _range_counts(range_m)
                rough = (counts + FINE_PER_ROUGH // 2) // FINE_PER_ROUGH
                rate, fine_rate = _rate_counts(rate_mps)
                message.satellites[number] = (rough // ROUGH, 0, rough % ROUGH, rate)
                fine, cn0 = counts - rough * FINE_PER_ROUGH, _cn0_count(cn0_dbhz_)
                message.cells[number, SIGNAL] = (fine, PHASE_INVALID, 0, 0, cn0, fine_rate)
        messages.append(_encode(message))
    return messages


def decode_msm7(message: bytes) -> Msm7:
    """Decode one signal per satellite: the first one in the signal mask with a pseudorange.

    Raises
    ------
    ValueError
        If it is not a complete 1077 or 1097 message with a valid CRC.
    """
    raw = _decode(message)
    found: dict[str, tuple[float, float, float]] = {}
    for (number, _), (fine, _, _, _, cn0, fine_rate) in raw.cells.items():
        rough_ms, _, rough, rate = raw.satellites[number]
        name = raw.name(number)
        if name not in found and rough_ms != ROUGH_INVALID and fine != FINE_INVALID:
            counts = (ROUGH * rough_ms + rough) * FINE_PER_ROUGH + fine
            known = rate != RATE_INVALID and fine_rate != FINE_RATE_INVALID
            found[name] = (
                counts / (ROUGH * FINE_PER_ROUGH) * MS_M,
                rate + fine_rate / 10_000 if known else nan,
                cn0 * CN0_STEP_DBHZ if cn0 else nan,
            )
    # A message without satellites is valid; its masks are empty.
    ranges, rates, strengths = zip(*found.values(), strict=True) if found else ((),) * 3
    number, _, epoch_ms, more, _ = raw.head
    names = tuple(found)
    return Msm7(SYSTEMS[number], epoch_ms / 1000.0, names, ranges, rates, strengths, bool(more))


def msm7_satellites(message: bytes) -> tuple[str, ...]:
    """Return the names of the satellites of a message, in its order."""
    raw = _decode(message)
    return tuple(map(raw.name, raw.satellites))


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
    kept = {n: fields for n, fields in raw.satellites.items() if raw.name(n) not in lost}
    patched = _Message(raw.head, kept, {k: cell for k, cell in raw.cells.items() if k[0] in kept})
    for number in kept:
        _move(patched, number, _range_counts(changes_m.get(raw.name(number), 0.0)))
    # An unchanged message must stay byte for byte.
    return message if patched == raw else _encode(patched)


def _move(message: _Message, number: int, counts: int) -> None:
    """Add counts of 2^-29 ms to the pseudorange of each signal of a satellite, in place."""
    rough_ms, information, rough, rate = message.satellites[number]
    if counts == 0 or rough_ms == ROUGH_INVALID:
        return
    own = {key: cell for key, cell in message.cells.items() if key[0] == number}
    fines, steps = [cell[0] + counts for cell in own.values() if cell[0] != FINE_INVALID], 0
    if not all(FINE_INVALID < fine < -FINE_INVALID for fine in fines):
        # The same number of steps for all signals, since they share the rough range.
        steps = round(sum(fines) / len(fines) / FINE_PER_ROUGH)
    whole = rough_ms * ROUGH + rough + steps
    if not 0 <= whole < ROUGH_INVALID * ROUGH:
        message.satellites[number] = (ROUGH_INVALID, information, rough, rate)
        return
    message.satellites[number] = (whole // ROUGH, information, whole % ROUGH, rate)
    for key, (fine, phase, *rest) in own.items():
        if fine != FINE_INVALID:
            fine = _within(fine + counts - steps * FINE_PER_ROUGH, FINE_INVALID)
        if phase != PHASE_INVALID:
            phase = _within(phase - steps * PHASE_PER_ROUGH, PHASE_INVALID)
        message.cells[key] = (fine, phase, *rest)


def _within(value: int, invalid: int) -> int:
    """Return `value`, or the field's invalid mark if it is out of range."""
    return value if invalid < value < -invalid else invalid


def _range_counts(range_m: float) -> int:
    return round(range_m / MS_M * ROUGH * FINE_PER_ROUGH)


def _rate_counts(rate_mps: float) -> tuple[int, int]:
    """Split a rate into integer m/s and the remaining counts of 0.1 mm/s."""
    # Written so that NaN is out of range too.
    if not abs(rate_mps) < -RATE_INVALID:
        return RATE_INVALID, FINE_RATE_INVALID
    whole = round(rate_mps)
    return whole, round((rate_mps - whole) * 10_000)


def _cn0_count(cn0_dbhz: float) -> int:
    return min(max(round(cn0_dbhz / CN0_STEP_DBHZ), 0), 1023) if isfinite(cn0_dbhz) else 0


def _encode(raw: _Message) -> bytes:
    """Encode the complete message: header, masks, satellite and cell data field by field."""
    signals = sorted({signal for _, signal in raw.cells})
    columns = [
        *(((value,), width) for value, width in zip(raw.head, HEAD_BITS, strict=True)),
        ((sum(1 << (64 - number) for number in raw.satellites),), 64),
        ((sum(1 << (32 - signal) for signal in signals),), 32),
        ([int((n, s) in raw.cells) for n in raw.satellites for s in signals], 1),
        *zip(zip(*raw.satellites.values(), strict=True), map(abs, SATELLITE_BITS), strict=False),
        *zip(zip(*raw.cells.values(), strict=True), map(abs, CELL_BITS), strict=False),
    ]
    return wrap_message(pack_columns(columns))


def _decode(message: bytes) -> _Message:
    bits = BitReader(unwrap_message(message))
    number = bits.unsigned(HEAD_BITS[0])
    if number not in SYSTEMS:
        raise ValueError(f"RTCM {number} is not MSM7 of GPS or Galileo (1077, 1097)")
    head = (number, *(bits.unsigned(width) for width in HEAD_BITS[1:]))
    numbers, signals = (
        [i + 1 for i, one in enumerate(bits.column(width, 1)) if one] for width in (64, 32)
    )
    pairs = [(n, s) for n in numbers for s in signals]
    present = bits.column(len(pairs), 1)
    keys = [key for key, one in zip(pairs, present, strict=True) if one]
    satellites = [bits.column(len(numbers), width) for width in SATELLITE_BITS]
    cells = [bits.column(len(keys), width) for width in CELL_BITS]
    return _Message(
        head,
        dict(zip(numbers, zip(*satellites, strict=True), strict=True)),
        dict(zip(keys, zip(*cells, strict=True), strict=True)),
    )
