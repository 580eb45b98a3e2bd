"""CRC-16/MCRF4XX by slicing tables, eight bytes a step [1]_; MAVLink's checksum.

References
----------
.. [1] Kounavis and Berry, "A Systematic Approach to Building High Performance Software-based CRC
       Generators", ISCC 2005.
"""

from array import array
from functools import cache

POLYNOMIAL = 0x8408  # reflected
SLICES = 8  # bytes a step


@cache
def slicing_tables() -> "array[int]":
    """Eight tables of 256 entries: entry 256 n + b is the CRC of byte b followed by n zeros."""
    tables = array("H", bytes(2 * SLICES * 256))
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (POLYNOMIAL if crc & 1 else 0)
        tables[byte] = crc
    # One more zero behind the byte is one more step of the register.
    for at in range(256, len(tables)):
        shorter = tables[at - 256]
        tables[at] = shorter >> 8 ^ tables[shorter & 0xFF]
    return tables
