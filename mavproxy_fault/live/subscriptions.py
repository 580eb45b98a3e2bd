"""Viewer subscriptions: samples of chosen messages, as received and as sent, at a bounded rate.

On either side the first frame in each 20 ms of the vehicle's time is sampled, so that a frame
without a fault gives the same sample on both. Frames are kept as they are until a viewer reads
them. A subscription expires unless it is renewed; without subscriptions no frame is sampled.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.sender_rules import SAMPLE_PERIOD_US
from mavproxy_fault.wire.dialect import Layout, find_layout, message_layout, message_names
from mavproxy_fault.wire.frame import Frame, Number, frame_header

if TYPE_CHECKING:
    from mavproxy_fault.live.watched_ranges import RangeSampler

LEASE_S = 5.0  # a subscription expires this long after its last renewal
MOST_MESSAGES = 32
MOST_SAMPLERS = 256
MOST_ROWS = 500  # buffered between two reads: 10 s, or 0.2 s of a flight at 50 times the speed

RANGES = "PSEUDORANGE"
RECEIVED, SENT = (False,), (True,)
SIDES: tuple[tuple[bool, ...], ...] = (), RECEIVED, SENT, (False, True)  # by a record's number

Row = tuple[Number | None, ...]


class Watched(msgspec.Struct, frozen=True, kw_only=True):
    """Samples of one message of one sender since the last read.

    `instance` distinguishes sensors of one kind, or named values. A row is the timestamp [us] on
    the vehicle's clock, then the values of `fields`. `sent` is None if it equals `received`.
    """

    message: str
    system: int
    component: int
    instance: Number | str
    fields: tuple[str, ...]
    received: list[Row]
    sent: list[Row] | None


class MessageSampler:
    """Samples one message of one sender."""

    def __init__(self, described: Layout) -> None:
        fields = described.fields.values()
        self.fields = tuple(
            f"{field.name}[{n}]" if field.count else field.name
            for field in fields
            if field.type != "char"
            for n in range(max(field.count, 1))
        )
        # Rows hold numbers only; text fields are skipped.
        self._payload = struct.Struct(
            "<"
            + "".join(
                f"{field.length}x" if field.type == "char" else field.code * max(field.count, 1)
                for field in fields
            )
        )
        self.received: list[tuple[int, bytes]] = []
        self.sent: list[tuple[int, bytes]] = []
        self._periods = [-1, -1]

    def note(self, frame: Frame, t_us: int, *, sent: bool) -> None:
        """Take a sample, unless this period already has one."""
        period = t_us // SAMPLE_PERIOD_US
        rows = self.sent if sent else self.received
        # Bounded: a viewer may be slow or gone.
        if period == self._periods[sent] or len(rows) >= MOST_ROWS:
            return
        self._periods[sent] = period
        # MAVLink 2 truncates trailing zeros; extra fields of a newer dialect are ignored.
        size = self._payload.size
        rows.append((t_us, frame.payload[:size].ljust(size, b"\0")))

    def drain(self) -> tuple[tuple[str, ...], list[Row], list[Row]]:
        """Return the fields and the received and sent rows since the last call."""
        received = [(t_us, *self._payload.unpack(values)) for t_us, values in self.received]
        sent = received
        if self.sent != self.received:
            sent = [(t_us, *self._payload.unpack(values)) for t_us, values in self.sent]
        self.received, self.sent = [], []
        return self.fields, received, sent


class SubscribedMessages:
    """The subscribed messages and their samples; `ids` are the message ids to sample."""

    def __init__(self) -> None:
        self.ids: frozenset[int] = frozenset()
        self._until_s: dict[str, float] = {}
        self._names: dict[int, list[str]] = {}
        self._sources: dict[tuple[str, int, int, Number | str], MessageSampler | RangeSampler] = {}

    def watch(self, names: Iterable[str], now_s: float) -> None:
        """Subscribe to messages (PSEUDORANGE: ranges in TUNNEL) or renew their subscriptions.

        Raises
        ------
        ConfigError
            If a message does not exist or there are too many.
        """
        requested = set(names)
        if "SETUP_SIGNING" in requested:
            raise ConfigError("watch: SETUP_SIGNING holds a key; request other messages")
        for name in requested - {RANGES}:
            if find_layout(name) is None:
                from mavproxy_fault.documents.suggestion import (
                    suggest_known,  # who only shows need not load it
                )

                raise ConfigError(
                    f"watch: {name} is not a message; {suggest_known(name, message_names())}"
                )
        # The limit counts all viewers.
        count = len(requested | self._until_s.keys())
        if count > MOST_MESSAGES:
            raise ConfigError(
                f"watch: {count} messages are too many; request at most {MOST_MESSAGES}"
            )
        self._until_s |= dict.fromkeys(requested, now_s + LEASE_S)
        self._index()

    def expire(self, now_s: float) -> None:
        """Drop expired subscriptions."""
        # Fast path: none has expired.
        if all(until_s > now_s for until_s in self._until_s.values()):
            return
        self._until_s = {name: until for name, until in self._until_s.items() if until > now_s}
        self._sources = {
            key: sampler for key, sampler in self._sources.items() if key[0] in self._until_s
        }
        self._index()

    def _index(self) -> None:
        self._names = {}
        for name in self._until_s:
            number = message_layout("TUNNEL" if name == RANGES else name).id
            self._names.setdefault(number, []).append(name)
        self.ids = frozenset(self._names)

    def sent(self, raw: bytes, t_us: int) -> None:
        """Sample sent bytes if they are a frame of a subscribed message."""
        # Only the id is read, since most messages have no viewer.
        head, number, _ = frame_header(raw, 0, len(raw))
        if head and number in self.ids:
            self.sample(Frame(raw, message_layout(number)), t_us, SENT)

    def note_samples(self, records: bytes) -> None:
        """Take samples of machine code: four times the time plus the sides, and the frame."""
        at = 0
        while at < len(records):
            word = int.from_bytes(records[at : at + 8])
            _, number, end = frame_header(records, at + 8, len(records))
            raw, at = records[at + 8 : end], end
            if number in self.ids:
                self.sample(Frame(raw, message_layout(number)), word >> 2, SIDES[word & 3])

    def sample(self, frame: Frame, t_us: int, sides: Sequence[bool]) -> None:
        """Sample a frame of a subscribed message, as received (False) or sent (True)."""
        value = frame.read(frame.layout.instance) if frame.layout.instance else 0
        instance = value.decode("ascii", "replace") if isinstance(value, bytes) else value
        for name in self._names[frame.id]:
            key = (name, frame.system, frame.component, instance)
            source = self._sources.get(key)
            if source is None:
                # Bounded: a peer can send frames with any number of sender ids.
                if len(self._sources) >= MOST_SAMPLERS:
                    return
                source = self._sources[key] = new_sampler(name)
            for sent in sides:
                source.note(frame, t_us, sent=sent)

    def drain(self) -> list[Watched]:
        """Return the samples since the last call."""
        samples = []
        for (name, system, component, instance), source in self._sources.items():
            fields, received, sent = source.drain()
            if received or sent:
                samples.append(
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
        return samples


def new_sampler(name: str) -> "MessageSampler | RangeSampler":
    """Return the sampler for one message of one sender."""
    if name != RANGES:
        return MessageSampler(message_layout(name))
    from mavproxy_fault.live.watched_ranges import (
        RangeSampler,  # RTCM is loaded for those who want it
    )

    return RangeSampler()
