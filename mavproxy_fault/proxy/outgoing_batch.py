"""Outgoing batch: what leaves the core at one time."""

import itertools

from mavproxy_fault.proxy.announcements import COMPONENT
from mavproxy_fault.wire.frame import STX_V1, STX_V2, Frame

LARGEST_DATAGRAM = 65_507  # bytes of payload of an IPv4 datagram
OutgoingBatch = list[tuple[int, bytes]]  # links as a bit mask, and bytes


def source_of(raw: Frame | bytes) -> tuple[int, int]:
    """Return the sender's system and component from the header, (0, 0) without one."""
    if isinstance(raw, Frame):
        return raw.system, raw.component
    if len(raw) > 6 and raw[0] == STX_V2:
        return raw[5], raw[6]
    if len(raw) > 4 and raw[0] == STX_V1:
        return raw[3], raw[4]
    return 0, 0


def join_datagrams(batch: OutgoingBatch) -> OutgoingBatch:
    """Join consecutive frames for the same links into datagrams, except announcements."""
    joined: OutgoingBatch = []

    def kind(item: tuple[int, bytes]) -> tuple[int, bool]:
        return item[0], source_of(item[1])[1] == COMPONENT

    for (mask, _), group in itertools.groupby(batch, key=kind):
        data = b""
        for _, raw in group:
            if len(data) + len(raw) > LARGEST_DATAGRAM:
                joined.append((mask, data))
                data = b""
            data += raw
        joined.append((mask, data))
    return joined
