"""The ranges of one epoch as the fault engine sees them: a message of its own, on no link."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import ClassVar

import msgspec

from mavproxy_fault.wire.dialect import known

UNCHANGED: Mapping[str, float] = MappingProxyType({})


class RangeEpoch(msgspec.Struct, frozen=True):
    """Satellites by name, metres added to their ranges, and those that are lost."""

    # Faults of satellites ask for the message that carries raw ranges on a link.
    id: ClassVar[int] = known("TUNNEL").id
    system: ClassVar[int] = 0
    component: ClassVar[int] = 0

    satellites: tuple[str, ...]
    added_m: Mapping[str, float] = UNCHANGED
    lost: frozenset[str] = frozenset()

    def changed(self, added_m: Mapping[str, float], lost: Iterable[str]) -> "RangeEpoch":
        """The epoch with more metres on some ranges, and without some satellites."""
        sums = dict(self.added_m)
        for name, metres in added_m.items():
            sums[name] = sums.get(name, 0.0) + metres
        return RangeEpoch(self.satellites, sums, self.lost | frozenset(lost))
