"""u-blox frames for tests: what a receiver writes, packed by the satellites' own documents.

Field orders are those of IS-GPS-200N figure 20-1 and Galileo OS SIS ICD 2.1 tables 37 to 41.
"""

from collections.abc import Sequence
from math import pi
from struct import pack

from analysis.samples.sample import Epoch
from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rtcm.bit_fields import pack_columns
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris
from mavproxy_fault.rtcm.transport import crc24q

SYSTEM = {"G": 0, "E": 2, "J": 5}
Field = tuple[int, int]


def frame(kind: int, payload: bytes) -> bytes:
    """A frame of class RXM with its checksum."""
    body = bytes([0x02, kind]) + pack("<H", len(payload)) + payload
    first = second = 0
    for byte in body:
        first = first + byte & 255
        second = second + first & 255
    return b"\xb5b" + body + bytes([first, second])


def rawx(epoch: Epoch) -> bytes:
    """RXM-RAWX of an epoch of GPS, Galileo and QZSS."""
    rows = b""
    table = zip(
        epoch.satellites, epoch.pseudorange_m, epoch.doppler_mps, epoch.cn0_dbhz, strict=True
    )
    for name, range_m, rate_mps, cn0_dbhz in table:
        doppler_hz = -rate_mps * L1_HZ / SPEED_OF_LIGHT_MPS
        rows += pack("<ddf", range_m, 0.0, doppler_hz)
        rows += bytes([SYSTEM[name[0]], int(name[1:]), 0, 0]) + pack("<H", 1000)
        rows += bytes([round(cn0_dbhz), 3, 1, 6, 7, 0])
    return frame(
        0x15, pack("<dHbBBBH", epoch.tow_s, epoch.week, 18, len(rows) // 32, 1, 1, 0) + rows
    )


def sfrbx(satellite: str, words: Sequence[int]) -> bytes:
    """RXM-SFRBX of a subframe or a page."""
    signal = 1 if satellite[0] == "E" else 0
    head = bytes([SYSTEM[satellite[0]], int(satellite[1:]), signal, 0, len(words), 0, 2, 0])
    return frame(0x13, head + pack(f"<{len(words)}I", *words))


def count(value: float, exponent: int, unit: float = 1.0) -> int:
    """How many steps of 2^exponent a value has."""
    return round(value / unit / 2.0**exponent)


def angle(value: float) -> int:
    """Half turns by 2^-31, in 32 bits."""
    return (count(value, -31, pi) + 2**31) % 2**32 - 2**31


def broadcast(e: Ephemeris) -> bytes:
    """Everything a satellite sends of its orbit and clock."""
    pages = inav_pages(e) if e.satellite[0] == "E" else subframes(e)
    return b"".join(sfrbx(e.satellite, words) for words in pages)


def subframes(e: Ephemeris) -> list[list[int]]:
    """Subframes 1 to 3 as ten words of 30 bits, parity left 0."""
    iode, toe, toc = (e.iode & 255, 8), (round(e.toe_s / 16), 16), (round(e.toc_s / 16), 16)
    clock: list[Field] = [
        (e.week % 1024, 10), (1, 2), (e.accuracy, 4), (e.health, 6), (e.iode >> 8, 2), (0, 1),
        (0, 23), (0, 48), (0, 16), (count(e.group_delay_s, -31), 8), iode, toc,
        (count(e.af2_per_s, -55), 8), (count(e.af1, -43), 16), (count(e.af0_s, -31), 22), (0, 2),
    ]  # fmt: skip
    shape: list[Field] = [
        iode, (count(e.crs_m, -5), 16), (count(e.delta_n_rps, -43, pi), 16), (angle(e.m0_rad), 32),
        (count(e.cuc_rad, -29), 16), (count(e.eccentricity, -33), 32), (count(e.cus_rad, -29), 16),
        (count(e.sqrt_a, -19), 32), toe, (int(e.long_fit), 1), (0, 7),
    ]  # fmt: skip
    plane: list[Field] = [
        (count(e.cic_rad, -29), 16), (angle(e.omega0_rad), 32), (count(e.cis_rad, -29), 16),
        (angle(e.i0_rad), 32), (count(e.crc_m, -5), 16), (angle(e.omega_rad), 32),
        (count(e.omega_dot_rps, -43, pi), 24), iode, (count(e.idot_rps, -43, pi), 14), (0, 2),
    ]  # fmt: skip
    return [_words_30(number, rows) for number, rows in enumerate((clock, shape, plane), 1)]


def klobuchar_page(alpha: Sequence[float], beta: Sequence[float]) -> list[int]:
    """Subframe 4, page 18."""
    steps = (-30, -27, -24, -24, 11, 14, 16, 16)
    values = [(count(v, k), 8) for v, k in zip((*alpha, *beta), steps, strict=True)]
    return _words_30(4, [(1, 2), (56, 6), *values, (0, 120)])


def _packed(rows: list[Field]) -> bytes:
    return pack_columns(((value,), width) for value, width in rows)


def _words_30(number: int, rows: list[Field]) -> list[int]:
    head = [(0x8B, 8), (0, 16), (1234, 17), (0, 2), (number, 3), (0, 2)]
    data = _packed([*head, *rows])
    assert len(data) == 30
    return [int.from_bytes(data[k : k + 3], "big") << 6 for k in range(0, 30, 3)]


def inav_pages(e: Ephemeris) -> list[list[int]]:
    """I/NAV words 1 to 5, each in a page of E1: eight words of 32 bits."""
    issue = (e.iode, 10)
    toe, toc = (round(e.toe_s / 60), 14), (round(e.toc_s / 60), 14)
    e5b, e1 = e.health >> 3, e.health & 7
    words: list[list[Field]] = [
        [(1, 6), issue, toe, (angle(e.m0_rad), 32), (count(e.eccentricity, -33), 32),
         (count(e.sqrt_a, -19), 32), (0, 2)],
        [(2, 6), issue, (angle(e.omega0_rad), 32), (angle(e.i0_rad), 32), (angle(e.omega_rad), 32),
         (count(e.idot_rps, -43, pi), 14), (0, 2)],
        [(3, 6), issue, (count(e.omega_dot_rps, -43, pi), 24), (count(e.delta_n_rps, -43, pi), 16),
         (count(e.cuc_rad, -29), 16), (count(e.cus_rad, -29), 16), (count(e.crc_m, -5), 16),
         (count(e.crs_m, -5), 16), (e.accuracy, 8)],
        [(4, 6), issue, (int(e.satellite[1:]), 6), (count(e.cic_rad, -29), 16),
         (count(e.cis_rad, -29), 16), toc, (count(e.af0_s, -34), 31), (count(e.af1, -46), 21),
         (count(e.af2_per_s, -59), 6), (0, 2)],
        [(5, 6), (0, 41), (count(e.group_delay_e5a_s, -32), 10), (count(e.group_delay_s, -32), 10),
         (e5b >> 1, 2), (e1 >> 1, 2), (e5b & 1, 1), (e1 & 1, 1), (0, 55)],
    ]  # fmt: skip
    return [_page(int.from_bytes(_packed(rows), "big")) for rows in words]


def _page(word: int) -> list[int]:
    even = word >> 16  # behind two bits of 0: even, nominal
    odd = 0b10 << 80 | (word & 0xFFFF) << 64
    crc = crc24q((even << 82 | odd).to_bytes(25, "big"))
    whole = even << 14 << 128 | (odd << 24 | crc) << 22
    return [whole >> 32 * k & 0xFFFFFFFF for k in reversed(range(8))]
