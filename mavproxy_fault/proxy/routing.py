"""Routing: MAVLink's target rules between any number of links, and a loop guard.

A broadcast frame goes to all other links, a frame for one component to the links on which that
component was heard [1]_; `sender_rules` has the rule. Sets of links are bit masks.

References
----------
.. [1] MAVLink developer guide, "Routing".
"""

from array import array
from functools import cache

from mavproxy_fault.proxy.sender_rules import read_target, select_links
from mavproxy_fault.proxy.senders import LINKS, SYSTEM_LINKS
from mavproxy_fault.wire.dialect import find_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.signing import SETUP_SIGNING

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
LOOP_WINDOW_US = 1_000_000  # chosen: far above the round trip of a loop
MAX_REMEMBERED = 4096  # chosen: about a second of traffic; bounds the memory


@cache
def target_offsets(name: str) -> tuple[int, int]:
    """Return the offsets of a message's target system and component; -1 if it has none."""
    layout = find_layout(name)
    if layout is None:  # an unknown message
        return -1, -1
    fields = layout.fields
    system, component = fields.get("target_system"), fields.get("target_component")
    return (system.offset if system else -1), (component.offset if component else -1)


class Routes:
    """The links each sender was heard on, in the senders array shared with the compiled path."""

    def __init__(self, link_count: int, senders: "array[int]", vehicle_links: int) -> None:
        self.all_links = (1 << link_count) - 1
        self.vehicle_links = vehicle_links
        self.home_links: dict[
            tuple[int, int], int
        ] = {}  # the link each component was first heard on
        self._senders = senders

    def note_sender(self, system: int, component: int, link: int) -> bool:
        """Record that a sender was heard on a link; True if it was also heard on others."""
        bit = 1 << link
        sender = system << 8 | component
        links = self._senders[LINKS + sender]
        if not links & bit:
            self.home_links.setdefault((system, component), link)
            links |= bit
            self._senders[LINKS + sender] = links
            self._senders[SYSTEM_LINKS + system] |= bit
        return links != bit

    def select(self, frame: Frame, link: int) -> int:
        """Select the links that a frame from `link` goes to, as a bit mask."""
        elsewhere = self.all_links & ~(1 << link)
        places = target_offsets(frame.layout.name)
        if places[0] < 0:
            return elsewhere
        target = read_target(frame.raw, frame.payload_at, frame.length, places)
        if frame.id == SETUP_SIGNING:
            return self._key_links(target) & elsewhere
        return select_links(self._senders, target, elsewhere)

    def _key_links(self, target: int) -> int:
        """Select the links for a signing key: where its target was heard, else the vehicle's."""
        # Other components of the system have no need of it.
        component = target | (0 if target & 0xFF else AUTOPILOT)
        return self._senders[LINKS + component] or self.vehicle_links


class LoopGuard:
    """Stops frames that circulate in a loop, and nothing else.

    Used only for senders heard on several links, which every loop causes. A frame may return as
    often as it came from the sender's home link (an echo does that), and once more in case the
    sender has moved; a loop returns it more often.
    """

    def __init__(self) -> None:
        self._recent: dict[bytes, list[int]] = {}
        self._older: dict[bytes, list[int]] = {}
        self._since_us = 0

    def admits(self, raw: bytes, *, from_home: bool, now_us: int) -> bool:
        """Whether to forward this frame."""
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
