"""The frames that wait until they are due, in memory that the core and machine code share.

`put`, `take` and `follow_simulator` are rules in numbers only, which `compiled` compiles. The queue
is a binary heap of places, by due time and, of equal ones, in the order in which they came.
"""

from collections.abc import MutableSequence
from functools import cached_property
from typing import Any

from mavproxy_fault.fault_parts.memory import new_table
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.proxy.sender_rules import MAX_TIME_JUMP_US

MOST = 1 << 18  # chosen: 10 s of 26,000 frames a second; what does not fit is lost, and counted
SLOT = 320  # bytes kept for a frame, more than the longest
# Waiting, put so far, a free place + 1, newest due time, wall time minus a simulator's time.
COUNT, PUT, FREE, LAST_DUE, SIMULATOR_OFFSET = range(5)
LOST = 5  # frames that found the queue full, by the links that they were for
MOST_LINKS = 63  # in a mask
HEAP = LOST + MOST_LINKS
ROWS = HEAP + MOST
DUE, ORDER, LINKS, LENGTH = range(4)  # of a row; ORDER links free places
ROW = 4
OWN = -1  # length of what the core keeps and releases
SIZE = ROWS + ROW * MOST

Queue = MutableSequence[int]


def is_before(queue: Queue, one: int, other: int) -> bool:
    """Whether what is at a place leaves before what is at another."""
    a, b = ROWS + ROW * one, ROWS + ROW * other
    if queue[a + DUE] != queue[b + DUE]:
        return queue[a + DUE] < queue[b + DUE]
    return queue[a + ORDER] < queue[b + ORDER]


def put(queue: Queue, due_us: int, links: int, length: int) -> int:
    """Put a frame into the queue; its place, -1 if it is full, which is counted."""
    at = queue[COUNT]
    if at == MOST:
        for link in range(MOST_LINKS):
            queue[LOST + link] += links >> link & 1
        return -1
    place, queue[COUNT] = at, at + 1
    if queue[FREE]:
        place = queue[FREE] - 1
        queue[FREE] = queue[ROWS + ROW * place + ORDER]
    row = ROWS + ROW * place
    queue[row + DUE], queue[row + ORDER] = due_us, queue[PUT]
    queue[row + LINKS], queue[row + LENGTH] = links, length
    queue[PUT] += 1
    while at > 0 and is_before(queue, place, queue[HEAP + (at - 1) // 2]):
        queue[HEAP + at] = queue[HEAP + (at - 1) // 2]
        at = (at - 1) // 2
    queue[HEAP + at] = place
    return place


def take(queue: Queue) -> int:
    """Take the first frame; its place, which keeps its content until the next `put`."""
    first, count, at = queue[HEAP], queue[COUNT] - 1, 0
    last = queue[HEAP + count]
    while 2 * at + 1 < count:
        child = 2 * at + 1
        if child + 1 < count and is_before(queue, queue[HEAP + child + 1], queue[HEAP + child]):
            child += 1
        if is_before(queue, last, queue[HEAP + child]):
            break
        queue[HEAP + at] = queue[HEAP + child]
        at = child
    queue[HEAP + at], queue[COUNT] = last, count
    queue[ROWS + ROW * first + ORDER], queue[FREE] = queue[FREE], first + 1
    return first


def follow_simulator(queue: Queue, t_us: int, now_us: int) -> None:
    """Move what waits with the clock of a simulator, whose HIL_SENSOR of `t_us` came at `now_us`.

    So a delay lasts its seconds of the simulator's time, at any speed of it; while it stands still,
    for example waiting for the frame that is delayed, wall time counts. A jump is another simulator
    or a new start: nothing moves with it.
    """
    offset_us, queue[SIMULATOR_OFFSET] = queue[SIMULATOR_OFFSET], now_us - t_us
    moved_us = now_us - t_us - offset_us
    jumped = offset_us == 0 or abs(moved_us) > MAX_TIME_JUMP_US
    if jumped or moved_us == 0 or queue[COUNT] == 0:
        return
    for n in range(queue[COUNT]):
        queue[ROWS + ROW * queue[HEAP + n] + DUE] += moved_us
    queue[LAST_DUE] = max(queue[LAST_DUE], now_us)  # what is overdue now was not so before


class DelayQueue:
    """The queue's `numbers`, and the `frames` that machine code has put there."""

    def __init__(self) -> None:
        self.numbers: Any = new_table("q", SIZE)
        self._raws: dict[int, bytes] = {}

    @cached_property
    def frames(self) -> Any:
        """Room for the bytes of frames."""
        return new_table("B", MOST * SLOT)

    @property
    def first_us(self) -> int:
        """When the first frame is due, NEVER_US without one."""
        numbers = self.numbers
        found: int = numbers[ROWS + ROW * numbers[HEAP] + DUE] if numbers[COUNT] else NEVER_US
        return found

    def hold(self, due_us: int, links: int, raw: bytes) -> None:
        """Keep bytes, which the core releases."""
        place = put(self.numbers, due_us, links, OWN)
        if place >= 0:
            self._raws[place] = raw

    def release(self) -> tuple[int, bytes]:
        """Take the first frame: its links and its bytes."""
        place = take(self.numbers)
        _, _, links, length = self.numbers[ROWS + ROW * place : ROWS + ROW * (place + 1)]
        if length == OWN:
            return links, self._raws.pop(place)
        return links, bytes(self.frames[SLOT * place : SLOT * place + length])
