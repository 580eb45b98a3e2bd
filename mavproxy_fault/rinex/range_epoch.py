"""The ranges of one epoch of a file, as a message for the fault engine."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import msgspec

from mavproxy_fault.wire.dialect import message_layout


class Setting(NamedTuple):
    """The value of a plant parameter and its rate per second."""

    value: float
    rate: float


UNCHANGED: Mapping[str, float] = MappingProxyType({})
UNSET: Mapping[str, Setting] = MappingProxyType({})


class RangeEpoch(msgspec.Struct, frozen=True):
    """Satellites by name, metres added to their ranges, lost satellites, and plant parameters such
    as `spoof_north_m[all]`."""

    # Satellite faults act on the message that carries raw ranges on a link.
    id: ClassVar[int] = message_layout("TUNNEL").id
    system: ClassVar[int] = 0
    component: ClassVar[int] = 0

    satellites: tuple[str, ...]
    added_m: Mapping[str, float] = UNCHANGED
    lost: frozenset[str] = frozenset()
    settings: Mapping[str, Setting] = UNSET

    def changed(self, added_m: Mapping[str, float], lost: Iterable[str]) -> "RangeEpoch":
        """Return the epoch with metres added to ranges and further satellites lost."""
        sums = dict(self.added_m)
        for name, metres in added_m.items():
            sums[name] = sums.get(name, 0.0) + metres
        return msgspec.structs.replace(self, added_m=sums, lost=self.lost | frozenset(lost))

    def with_settings(self, settings: Mapping[str, Setting]) -> "RangeEpoch":
        """Return the epoch with further plant parameters; the newest value of a name counts."""
        return msgspec.structs.replace(self, settings={**self.settings, **settings})
