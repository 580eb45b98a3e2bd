"""Departures: what leaves the core at one time, and who sent it."""

import itertools

from mavproxy_fault.proxy.announcements import COMPONENT
from mavproxy_fault.wire.frame import STX_V1, STX_V2, Frame

LARGEST_DATAGRAM = 65_507  # bytes of payload of an IPv4 datagram
OutgoingBatch = list[tuple[int, bytes]]  # what leaves now: the links as a bit mask, and the bytes


def source_of(raw: Frame | bytes) -> tuple[int, int]:
    """System and component by the header, (0, 0) where there is none."""
    if isinstance(raw, Frame):
        return raw.system, raw.component
    if len(raw) > 6 and raw[0] == STX_V2:
        return raw[5], raw[6]
    if len(raw) > 4 and raw[0] == STX_V1:
        return raw[3], raw[4]
    return 0, 0


def join_datagrams(departures: OutgoingBatch) -> OutgoingBatch:
    """Neighbours for the same links as one datagram, but for the proxy's own announcements."""
    joined: OutgoingBatch = []

    def kind(departure: tuple[int, bytes]) -> tuple[int, bool]:
        return departure[0], source_of(departure[1])[1] == COMPONENT

    for (mask, _), group in itertools.groupby(departures, key=kind):
        data = b""
        for _, raw in group:
            if len(data) + len(raw) > LARGEST_DATAGRAM:
                joined.append((mask, data))
                data = b""
            data += raw
        joined.append((mask, data))
    return joined
