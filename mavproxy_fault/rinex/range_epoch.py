"""The ranges of one epoch as the fault engine sees them: a message of its own, on no link."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import msgspec

from mavproxy_fault.wire.dialect import message_layout


class Setting(NamedTuple):
    """A parameter of the plant, and how fast it changes per second."""

    value: float
    rate: float


UNCHANGED: Mapping[str, float] = MappingProxyType({})
UNSET: Mapping[str, Setting] = MappingProxyType({})


class RangeEpoch(msgspec.Struct, frozen=True):
    """Satellites by name, metres added to their ranges, those that are lost, and the plant's
    parameters (`spoof_north_m[all]`) that are set."""

    # Faults of satellites ask for the message that carries raw ranges on a link.
    id: ClassVar[int] = message_layout("TUNNEL").id
    system: ClassVar[int] = 0
    component: ClassVar[int] = 0

    satellites: tuple[str, ...]
    added_m: Mapping[str, float] = UNCHANGED
    lost: frozenset[str] = frozenset()
    settings: Mapping[str, Setting] = UNSET

    def changed(self, added_m: Mapping[str, float], lost: Iterable[str]) -> "RangeEpoch":
        """The epoch with more metres on some ranges, and without some satellites."""
        sums = dict(self.added_m)
        for name, metres in added_m.items():
            sums[name] = sums.get(name, 0.0) + metres
        return msgspec.structs.replace(self, added_m=sums, lost=self.lost | frozenset(lost))

    def with_settings(self, settings: Mapping[str, Setting]) -> "RangeEpoch":
        """The epoch with more of the plant's parameters set; the newest of a name holds."""
        return msgspec.structs.replace(self, settings={**self.settings, **settings})
