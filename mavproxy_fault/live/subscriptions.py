"""What viewers watch: chosen messages as they came and as they left, at a bounded rate.

On either side the first frame in each fiftieth of a second of the vehicle's time is taken, so
that a frame which no fault touched is the same sample on both. A message is watched as long as
somebody goes on asking for it; without a viewer nothing is looked at.
"""

import struct
from collections.abc import Iterable
from typing import TYPE_CHECKING

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import Layout, find_layout, message_layout, message_names
from mavproxy_fault.wire.frame import STX_V2, Frame, Number

if TYPE_CHECKING:
    from mavproxy_fault.live.watched_ranges import RangeSampler

PERIOD_US = 20_000
LEASE_S = 5.0  # how long a message stays watched after the last request for it
MOST_MESSAGES = 32
MOST_SAMPLERS = 256
MOST_ROWS = 100  # kept for a viewer's next look: two seconds

RANGES = "PSEUDORANGE"

Row = tuple[Number | None, ...]


class Watched(msgspec.Struct, frozen=True, kw_only=True):
    """Samples of one message of one source since the last look.

    `instance` tells sensors of one kind apart, or named values. A row is the stamp in microseconds
    on the vehicle's clock, then the values by `fields`. `sent` is None where what left is what
    came.
    """

    message: str
    system: int
    component: int
    instance: Number | str
    fields: tuple[str, ...]
    received: list[Row]
    sent: list[Row] | None


class MessageSampler:
    """One message of one sender: how its payload is read, and its samples not yet drained."""

    def __init__(self, described: Layout) -> None:
        fields = described.fields.values()
        self.fields = tuple(
            f"{field.name}[{n}]" if field.count else field.name
            for field in fields
            if field.type != "char"
            for n in range(max(field.count, 1))
        )
        # Text has no place in a row of numbers: it is skipped by its length.
        self._payload = struct.Struct(
            "<"
            + "".join(
                f"{field.length}x" if field.type == "char" else field.code * max(field.count, 1)
                for field in fields
            )
        )
        self.received: list[Row] = []
        self.sent: list[Row] = []
        self._periods = [-1, -1]

    def note(self, frame: Frame, t_us: int, *, sent: bool) -> None:
        """Take a sample, unless its fiftieth of a second has one."""
        period = t_us // PERIOD_US
        rows = self.sent if sent else self.received
        # Rows are bounded: a viewer may be slow or gone.
        if period == self._periods[sent] or len(rows) >= MOST_ROWS:
            return
        self._periods[sent] = period
        size = self._payload.size
        # MAVLink 2 cuts trailing zeros; fields of a newer dialect behind ours are cut off.
        values = self._payload.unpack(frame.payload[:size].ljust(size, b"\0"))
        rows.append((t_us, *values))

    def drain(self) -> tuple[tuple[str, ...], list[Row], list[Row]]:
        """Fields, and rows of both sides since the last call."""
        received, sent = self.received, self.sent
        self.received, self.sent = [], []
        return self.fields, received, sent


class SubscribedMessages:
    """The messages that are watched and their samples; `ids` are those of the frames to look at."""

    def __init__(self) -> None:
        self.ids: frozenset[int] = frozenset()
        self._until_s: dict[str, float] = {}
        self._names: dict[int, list[str]] = {}
        self._sources: dict[tuple[str, int, int, Number | str], MessageSampler | RangeSampler] = {}

    def watch(self, names: Iterable[str], now_s: float) -> None:
        """Watch messages (or PSEUDORANGE, what is in TUNNEL) from now on, or go on doing so.

        Raises
        ------
        ConfigError
            If one does not exist, or they are too many.
        """
        wanted = set(names)
        for name in wanted - {RANGES}:
            if find_layout(name) is None:
                from mavproxy_fault.documents.suggestion import (
                    suggest_known,  # who only shows need not load it
                )

                raise ConfigError(
                    f"watch: {name} is no message; {suggest_known(name, message_names())}"
                )
        # Of all viewers together.
        count = len(wanted | self._until_s.keys())
        if count > MOST_MESSAGES:
            raise ConfigError(f"watch: {count} messages are too many; at most {MOST_MESSAGES}")
        self._until_s |= dict.fromkeys(wanted, now_s + LEASE_S)
        self._index()

    def expire(self, now_s: float) -> None:
        """Forget the messages that nobody asks for any more."""
        # The usual case, without building anything.
        if all(until_s > now_s for until_s in self._until_s.values()):
            return
        self._until_s = {name: until for name, until in self._until_s.items() if until > now_s}
        self._sources = {key: one for key, one in self._sources.items() if key[0] in self._until_s}
        self._index()

    def _index(self) -> None:
        self._names = {}
        for name in self._until_s:
            number = message_layout("TUNNEL" if name == RANGES else name).id
            self._names.setdefault(number, []).append(name)
        self.ids = frozenset(self._names)

    def received(self, frame: Frame, t_us: int) -> None:
        """Look at a frame of a watched message that came."""
        self._note(frame, t_us, sent=False)

    def sent(self, raw: bytes, t_us: int) -> None:
        """Look at bytes that left."""
        # Too short for the header of a frame.
        if len(raw) < 8:
            return
        # Only the id is read: most bytes that leave are watched by nobody.
        number = int.from_bytes(raw[7:10], "little") if raw[0] == STX_V2 else raw[5]
        if number in self.ids:
            self._note(Frame(raw, message_layout(number)), t_us, sent=True)

    def _note(self, frame: Frame, t_us: int, *, sent: bool) -> None:
        field = frame.layout.instance or "id"
        found = frame.read(field) if field in frame.layout.fields else 0
        instance = found.decode("ascii", "replace") if isinstance(found, bytes) else found
        for name in self._names[frame.id]:
            key = (name, frame.system, frame.component, instance)
            source = self._sources.get(key)
            if source is None:
                # Anybody on a link can make up senders.
                if len(self._sources) >= MOST_SAMPLERS:
                    return
                source = self._sources[key] = new_sampler(name)
            source.note(frame, t_us, sent=sent)

    def drain(self) -> list[Watched]:
        """The samples since the last call."""
        found = []
        for (name, system, component, instance), source in self._sources.items():
            fields, received, sent = source.drain()
            if received or sent:
                found.append(
                    Watched(
                        message=name,
                        system=system,
                        component=component,
                        instance=instance,
                        fields=fields,
                        received=received,
                        # Equal rows are sent once.
                        sent=None if sent == received else sent,
                    )
                )
        return found


def new_sampler(name: str) -> "MessageSampler | RangeSampler":
    """What reads the frames of one sender."""
    if name != RANGES:
        return MessageSampler(message_layout(name))
    from mavproxy_fault.live.watched_ranges import (
        RangeSampler,  # RTCM is loaded for those who want it
    )

    return RangeSampler()
