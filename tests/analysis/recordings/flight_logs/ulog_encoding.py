"""PX4 logs for tests: a receiver's bytes as the messages of GPS_DUMP_COMM.

Layout of the file: PX4's ULog specification (header, B, F, A and D messages).
"""

from collections.abc import Sequence
from struct import pack

FIELDS = "uint64_t timestamp;uint8_t instance;uint8_t len;uint8_t[79] data;"
MOST = 79


def dump_log(
    sent: bytes,
    between: Sequence[tuple[int, int, bytes]] = (),
    topic: str = "gps_dump",
    fields: str = FIELDS,
) -> bytes:
    """A log with what a receiver sent; behind each message those of `between`.

    These are an instance, the bit of the direction, and at most 79 bytes. `fields` is what the log
    says that a message of PX4's form holds.
    """
    log = b"ULog\x01\x12\x35\x01" + pack("<Q", 0)
    log += _message("B", bytes(40)) + _message("F", f"{topic}:{fields}".encode())
    log += _message("A", pack("<BH", 0, 0) + topic.encode())
    chunks = [sent[i : i + MOST] for i in range(0, len(sent), MOST)] or [b""]
    for t_us, chunk in enumerate(chunks, 1):
        for instance, direction, data in [(0, 0, chunk), *between]:
            head = pack("<HQBB", 0, t_us, instance, direction | len(data))
            log += _message("D", head + data.ljust(MOST, b"\0"))
    return log


def _message(kind: str, payload: bytes) -> bytes:
    return pack("<H", len(payload)) + kind.encode() + payload
