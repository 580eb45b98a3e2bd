"""Where a frame goes: MAVLink's target rules between any number of links, and a guard on loops.

A frame for everybody goes to all other links, a frame for one component where that component was
heard [1]_; `sender_rules.links_towards` holds the rule. Sets of links are bit masks.

References
----------
.. [1] MAVLink developer guide, "Routing".
"""

from array import array
from functools import cache

from mavproxy_fault.proxy.sender_rules import read_target, select_links
from mavproxy_fault.proxy.senders import LINKS, SYSTEM_LINKS, new_senders
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

LOOP_WINDOW_US = 1_000_000
MAX_REMEMBERED = 4096


@cache
def target_offsets(name: str) -> tuple[int, int]:
    """Offsets of a message's target system and component; -1 without one."""
    fields = message_layout(name).fields
    system, component = fields.get("target_system"), fields.get("target_component")
    return (system.offset if system else -1), (component.offset if component else -1)


class Routes:
    """Who was heard on which links, kept in the array of senders that the compiled form shares."""

    def __init__(self, link_count: int, senders: "array[int] | None" = None) -> None:
        self.all_links = (1 << link_count) - 1
        self.home_links: dict[
            tuple[int, int], int
        ] = {}  # the link each component was first heard on
        self._senders = new_senders() if senders is None else senders

    def note_sender(self, system: int, component: int, link: int) -> bool:
        """Note a sender; True if it has been heard on other links too."""
        bit = 1 << link
        sender = system << 8 | component
        seen = self._senders[LINKS + sender]
        if not seen & bit:
            self.home_links.setdefault((system, component), link)
            seen |= bit
            self._senders[LINKS + sender] = seen
            self._senders[SYSTEM_LINKS + system] |= bit
        return seen != bit

    def select(self, frame: Frame, link: int) -> int:
        """The links a frame from `link` goes to."""
        elsewhere = self.all_links & ~(1 << link)
        places = target_offsets(frame.layout.name)
        if places[0] < 0:
            return elsewhere
        target = read_target(frame.raw, frame.payload_at, frame.length, places)
        return select_links(self._senders, target, elsewhere)


class LoopGuard:
    """Stops bytes that come round again and again, and nothing else.

    Asked only about senders heard on several links, without whom there is no loop. Bytes may come
    back as often as they came from the sender's home link (an echo does that), and once more for
    senders that moved; a loop brings them more often.
    """

    def __init__(self) -> None:
        self._recent: dict[bytes, list[int]] = {}
        self._older: dict[bytes, list[int]] = {}
        self._since_us = 0

    def admits(self, raw: bytes, *, from_home: bool, now_us: int) -> bool:
        """Whether to forward these bytes."""
        if now_us - self._since_us > LOOP_WINDOW_US or len(self._recent) >= MAX_REMEMBERED:
            self._older, self._recent, self._since_us = self._recent, {}, now_us
        counts = self._recent.get(raw)
        if counts is None:
            counts = self._recent[raw] = self._older.pop(raw, [0, 0])
        if from_home:
            counts[0] += 1
            return True
        counts[1] += 1
        return counts[1] <= 1 + counts[0]
