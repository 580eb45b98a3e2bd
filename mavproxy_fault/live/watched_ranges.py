"""Pseudoranges that viewers watch: TUNNEL fragments of RTCM to rows of metres by satellite."""

from mavproxy_fault.rtcm.msm7 import decode_msm7
from mavproxy_fault.rtcm.transport import Reassembler, tunnel_payload
from mavproxy_fault.wire.frame import Frame

MOST_EPOCHS = 100  # kept for a viewer's next look

Epochs = dict[int, dict[str, float]]  # metres by satellite, by stamp


class RangeSampler:
    """One receiver's ranges, as they came and as they left."""

    def __init__(self) -> None:
        self._messages = (Reassembler(), Reassembler())
        self._epochs: tuple[Epochs, Epochs] = ({}, {})

    def note(self, frame: Frame, t_us: int, *, sent: bool) -> None:
        """Take a fragment; the ranges of the message that it completes."""
        payload = tunnel_payload(frame)
        epochs = self._epochs[sent]
        # A viewer that does not look loses epochs, not the proxy its memory.
        if payload is None or len(epochs) >= MOST_EPOCHS:
            return
        for message in self._messages[sent].add(payload):
            try:
                data = decode_msm7(message)
            except ValueError:
                continue  # an ephemeris, or nothing known
            ranges = zip(data.satellites, data.pseudorange_m, strict=True)
            epochs.setdefault(t_us, {}).update(ranges)

    def drain(
        self,
    ) -> tuple[
        tuple[str, ...],
        list[tuple[int | float | None, ...]],
        list[tuple[int | float | None, ...]],
    ]:
        """Satellites, and rows of both sides since the last call; None where one is missing."""
        epochs, self._epochs = self._epochs, ({}, {})
        names = sorted({name for side in epochs for ranges in side.values() for name in ranges})
        received, sent = (
            [(t_us, *(ranges.get(name) for name in names)) for t_us, ranges in side.items()]
            for side in epochs
        )
        return tuple(names), received, sent
