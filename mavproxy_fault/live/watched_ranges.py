"""Pseudoranges for viewers: TUNNEL fragments of RTCM to rows of metres by satellite."""

from mavproxy_fault.rtcm.msm7 import decode_msm7
from mavproxy_fault.rtcm.transport import Reassembler, tunnel_payload
from mavproxy_fault.wire.frame import Frame

MOST_EPOCHS = 100  # buffered between two reads: 20 s at 5 Hz

Epochs = dict[int, dict[str, float]]  # timestamp [us] to satellite to pseudorange [m]
Rows = list[tuple[int | float | None, ...]]


class RangeSampler:
    """Samples the pseudoranges of one receiver, as received and as sent."""

    def __init__(self) -> None:
        self._messages = (Reassembler(), Reassembler())
        self._epochs: tuple[Epochs, Epochs] = ({}, {})

    def note(self, frame: Frame, t_us: int, *, sent: bool) -> None:
        """Add a fragment and store the ranges of a completed message."""
        payload = tunnel_payload(frame)
        epochs = self._epochs[sent]
        # Bounded: a viewer that stops reading loses epochs.
        if payload is None or len(epochs) >= MOST_EPOCHS:
            return
        for message in self._messages[sent].add(payload):
            try:
                data = decode_msm7(message)
            except ValueError:
                continue  # an ephemeris or an unknown message
            ranges = zip(data.satellites, data.pseudorange_m, strict=True)
            epochs.setdefault(t_us, {}).update(ranges)

    def drain(self) -> tuple[tuple[str, ...], Rows, Rows]:
        """Return the satellites and the received and sent rows since the last call.

        A missing satellite is None.
        """
        epochs, self._epochs = self._epochs, ({}, {})
        names = sorted({name for side in epochs for ranges in side.values() for name in ranges})
        received, sent = (
            [(t_us, *(ranges.get(name) for name in names)) for t_us, ranges in side.items()]
            for side in epochs
        )
        return tuple(names), received, sent
